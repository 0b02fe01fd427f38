"""The node that empties a bin through the public interface only."""
