"""Payloads: mass, centre of mass and inertia of bodies fixed to links, and drive gains from known masses."""

from haptid.inference.payloads.body import AttachedBody
from haptid.inference.payloads.estimates import DriveGains, PayloadEstimate, PayloadIdentification
from haptid.inference.payloads.identify import Recorded, identify_payloads

__all__ = [
    "AttachedBody",
    "DriveGains",
    "PayloadEstimate",
    "PayloadIdentification",
    "Recorded",
    "identify_payloads",
]
