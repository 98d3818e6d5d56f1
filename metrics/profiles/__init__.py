"""Profiles, one package or module a reference tool; `catalog` finds them, `choose` scores by them."""
