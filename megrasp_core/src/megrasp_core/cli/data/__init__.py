"""`megrasp data ...`."""
