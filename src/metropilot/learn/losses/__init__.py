"""Pure losses of arrays: no environment, no buffer, no network. One file a learner, equations by number."""
