"""The device file: its schema, its reader and its faults."""
