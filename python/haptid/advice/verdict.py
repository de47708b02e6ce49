"""The verdict of a diagnosis that knows what advice has proven."""

from __future__ import annotations

from collections.abc import Mapping

from haptid.advice.action import USE, Advice
from haptid.inference.diagnosis import Diagnosis, Verdict
from haptid.inference.diagnosis.verdict import ProvenChange, verdict

# Share of the unseen error that a change leaves at most where it explains what the residuals show.
_LEFT = 0.7
# Kinds of change that say the same as a finding.
_SAME: Mapping[str, tuple[str, ...]] = {
    "time delay": ("time shift", "common delay"),
    "influence": ("contact", "start", "stuck position", "clipped torque", "slip", "other log"),
    "drift": ("drift", "payload", "other log"),
    "friction near standstill": ("stribeck", "degressive friction", "presliding", "coulomb", "rest", "start"),
    "friction by direction": ("offset", "coulomb"),
    "viscosity by direction": ("viscosity by direction",),
    "bent viscosity": ("bent viscosity", "degressive friction", "viscous"),
    "friction by load": ("load friction",),
    "torque by position": ("torque by position", "spring", "zero offset", "gravity direction", "mounting"),
    "ripple": ("ripple",),
}


def verdict_with(diagnosis: Diagnosis, advice: Advice) -> Verdict:
    """The verdict, which takes for a cause what is proven, and not what residuals seem to be caused by.

    A reversed or exchanged channel leaves residuals that look late, bent or periodic. Where the first change removes
    half of the squared unseen error, or bodies prove it, findings on residuals are reasons only where they say the
    same as a change of the best combination. Elsewhere findings whose changes were tried without a proof are what
    residuals look like, and no more than a doubt.

    Args:
        diagnosis: of an estimate.
        advice: on the study that it is of.
    """
    first = advice.actions[0] if advice.actions else None
    parts = diagnosis.estimate, diagnosis.validation, diagnosis.findings
    if first is None or first.kind == USE or (first.proof == "unseen error" and first.after > _LEFT * first.before):
        proven = {action.kind for action in advice.actions}
        unproven = [name for name, same in _SAME.items() if advice.kinds & set(same) and not proven & set(same)]
        return verdict(*parts, unproven=unproven)
    kinds = {action.kind for action in advice.combination}
    agreeing = frozenset(name for name, same in _SAME.items() if kinds & set(same))
    return verdict(*parts, ProvenChange(first.change, agreeing))
