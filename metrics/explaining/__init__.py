"""What became of every box of a frame, in words."""
