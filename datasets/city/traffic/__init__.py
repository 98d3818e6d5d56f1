"""How road users move: car following, lane changes, signals, crossings."""
