"""`megrasp objects ...`."""
