"""Words of the pages in the languages that they are read in."""
