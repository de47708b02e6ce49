"""The result folder: what an identification writes, and reads back."""
