"""Criticality: what an error means for what the vehicle must do, from the motion of the ego and of road users."""
