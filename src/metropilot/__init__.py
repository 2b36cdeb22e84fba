"""metropilot drives metro trains."""
