"""Parts of the preview picture."""
