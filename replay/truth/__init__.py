"""Ground truth of a run: the frame it belongs to (`labelling`), moved to its instant (`times`), or new (`relabel`)."""
