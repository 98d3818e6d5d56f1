"""Results as Markdown, for pages that people go on writing."""
