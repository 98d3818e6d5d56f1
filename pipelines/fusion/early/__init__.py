"""Early."""
