"""Reading a whole log to find what is wrong with it."""
