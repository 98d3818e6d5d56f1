"""Average precision as COCO counts it."""
