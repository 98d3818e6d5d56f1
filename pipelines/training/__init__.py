"""Training of the camera detector that fbench ships, from logs with images and truth (extra `torch`)."""
