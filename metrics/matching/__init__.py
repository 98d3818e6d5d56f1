"""The one matcher: how alike boxes are, and which of them belong together."""
