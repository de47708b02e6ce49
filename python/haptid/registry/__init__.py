"""The index of a folder of devices, studies, logs and results: searched by name, by content hash, and by provenance.

The files are the truth; the index is made of them again at any time.
"""

from haptid.registry.index import Index, Indexed

__all__ = ["Index", "Indexed"]
