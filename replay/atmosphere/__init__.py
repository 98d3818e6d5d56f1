"""Equations of the air: how fog and rain weaken light, infrared and radar waves, and what they send back."""
