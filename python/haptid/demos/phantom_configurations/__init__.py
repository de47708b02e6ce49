"""One device in several mountings, as published for the PHANToM: fits, consistency, hand force, comparisons."""

from haptid.demos.phantom_configurations.plan import PhantomDemo
from haptid.demos.phantom_configurations.results import find, takes
from haptid.demos.phantom_configurations.sections import sections
from haptid.demos.phantom_configurations.tables import summary, values, write_files
from haptid.demos.plan import Kind

PHANTOM_CONFIGURATIONS = Kind(PhantomDemo, takes, find, write_files, values, sections, summary)
