"""Sections of a report, in the order of the page: one class and one template each."""

from haptid.report.section import Section
from haptid.report.sections.excitation import ExcitationSection
from haptid.report.sections.friction import FrictionSection
from haptid.report.sections.hand import HandSection
from haptid.report.sections.maps import MapsSection
from haptid.report.sections.mechanism import MechanismSection
from haptid.report.sections.parameters import ParametersSection
from haptid.report.sections.provenance import ProvenanceSection
from haptid.report.sections.residual import ResidualSection
from haptid.report.sections.torque import ErrorsSection, TorqueSection
from haptid.report.sections.torque_decomposition import TorqueDecompositionSection
from haptid.report.sections.verdict import VerdictSection

SECTIONS: tuple[type[Section], ...] = (
    VerdictSection,
    ParametersSection,
    TorqueSection,
    ErrorsSection,
    ResidualSection,
    FrictionSection,
    TorqueDecompositionSection,
    ExcitationSection,
    MechanismSection,
    MapsSection,
    HandSection,
    ProvenanceSection,
)

__all__ = ["SECTIONS", "Section"]
