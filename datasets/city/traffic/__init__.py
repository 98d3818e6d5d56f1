"""Motion of road users: car following, lane changes, signals, crossings."""
