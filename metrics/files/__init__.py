"""Truth and results of other systems, from files: `sequences` opens and pairs them."""
