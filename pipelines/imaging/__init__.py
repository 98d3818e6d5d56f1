"""Objects in images from points of LiDAR and radar, and their fusion with what cameras see."""
