"""Loop closure: how passive joints follow the active ones."""
