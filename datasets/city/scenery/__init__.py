"""The mesh of all that never moves: ground, buildings, plants, what stands in streets and beside roads."""
