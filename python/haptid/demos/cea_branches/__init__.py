"""Two branches of one device, as published for the CEA interface: essential parameters, apparent mass, compensation."""

from haptid.demos.cea_branches.plan import CeaDemo
from haptid.demos.cea_branches.results import find, takes
from haptid.demos.cea_branches.sections import sections
from haptid.demos.cea_branches.tables import summary, values, write_files
from haptid.demos.plan import Kind

CEA_BRANCHES = Kind(CeaDemo, takes, find, write_files, values, sections, summary)
