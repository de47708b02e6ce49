"""What every demonstration is made of: a folder with a plan, experiments, published tables, and what does not hold."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

HERE = Path(__file__).parent
PLAN, CLAIMS = "demo.toml", "claims.toml"


class Part(BaseModel):
    """A table of a plan: every key is known."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Claim(Part):
    """Something printed that does not hold, and the check that shows it."""

    name: str
    where: str
    printed: str
    found: str
    check: str


class Demo(Part):
    """A demonstration; paths are those of files in its folder."""

    schema_: int = Field(1, alias="schema", ge=1, le=1)
    name: str
    kind: str
    title: str
    source: str
    device: str
    claims: tuple[Claim, ...]

    @property
    def folder(self) -> Path:
        """Where its files are."""
        return HERE / self.name
