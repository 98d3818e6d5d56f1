"""Average precision and recall as pycocotools counts them: `profile`."""
