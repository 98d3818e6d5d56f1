"""Events of CLEAR that a match can be, as bits."""

SWITCH = 1  # The truth track's last match, after any gap, was with another id
START = 2  # The first match of its truth track, or the first after a miss
ASCEND = 4  # A switch to an id that was never matched before
TRANSFER = 8  # The id goes over from another truth track
MIGRATE = 16  # A transfer to a truth track that was never matched before
