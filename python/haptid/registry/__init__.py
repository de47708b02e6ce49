"""The index of a folder of devices, studies, logs and results: found by name, by content, and by what was made of what.

The files are the truth; the index is made of them again at any time.
"""

from haptid.registry.index import Index, Indexed

__all__ = ["Index", "Indexed"]
