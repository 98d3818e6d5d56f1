"""CLEAR MOT (`clear`), identity (`identity`), HOTA (`hota`), survival of occlusions, and their rows (`scores`)."""
