"""The detection and tracking challenges of Argoverse 2, as av2-api 0.3.6 counts them."""
