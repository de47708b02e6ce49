"""Methods of estimation, each a small frozen type."""
