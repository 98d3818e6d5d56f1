"""The algorithms of the thesis as written: the baseline that improved ones are compared with."""
