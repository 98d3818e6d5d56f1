"""Video: what the headers of its packets say, and in which of them decoding can begin. Nothing here decodes."""
