"""How a log becomes a motion: filters, delays and joint-side channels."""
