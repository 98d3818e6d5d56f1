"""Ground truth of a run: the frame it belongs to (`labelling`), moved to its instant (`times`), replaced (`relabel`)."""
