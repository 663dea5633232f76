"""The settings that every detector with a seed area has."""

from typing import Literal

from pydantic import Field

from roadtorch.geometry import SeedArea
from roadtorch.settings import Settings
from roadtorch.working import WorkingSize

THRESHOLD = "road from this likelihood on; the default has the best F on CamVid's three drives"
ISOLATED = "what becomes of road regions that do not touch the seed area"


class Decision(Settings):
    """Working size, seed area, and how the likelihood becomes a mask."""

    threshold: float = Field(default=0.5, ge=0, le=1, description=THRESHOLD)
    isolated: Literal["drop", "keep"] = Field(default="drop", description=ISOLATED)
    seed: SeedArea = Field(default=SeedArea(), description="the area taken to be road")
    working: WorkingSize = WorkingSize()
