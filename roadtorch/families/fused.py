"""The fused detector: naive Bayes over layout, texture, distance, place and look."""

from pydantic import Field
from torch import Tensor

from roadtorch import texture
from roadtorch.detectors import Analysis, Entry
from roadtorch.families.decision import THRESHOLD, Decision
from roadtorch.families.texture import Saturation, TextureSettings, unsaturated_uniformity
from roadtorch.fusion import (
    RoadSettings,
    distance_likelihood,
    road_place,
    seed_distance,
    segment_road,
)
from roadtorch.layout.labeller import HORIZONTAL, LabellerSettings, decide_layout, segment_layout
from roadtorch.segments import brightened, measure_segments
from roadtorch.superpixels import paint
from roadtorch.working import Superpixels, at_working_size


class FusionSettings(Decision):
    """The fused detector: each part with its own group of settings."""

    threshold: float = Field(default=0.39, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    labeller: LabellerSettings = LabellerSettings()
    texture: TextureSettings = TextureSettings()
    saturation: Saturation = Saturation()
    road: RoadSettings = RoadSettings()


def _fusion(settings: FusionSettings) -> Analysis:
    def analyse(image: Tensor) -> dict[str, Tensor]:
        image = brightened(image, settings.labeller.exposure)
        labels = settings.superpixels.cut(image)
        segments = measure_segments(image, labels)
        layout = segment_layout(segments, settings.labeller)
        fused, uniformity, clipped = unsaturated_uniformity(
            image, labels, settings.seed, settings.texture, settings.saturation
        )
        even = texture.uniformity_likelihood(uniformity, settings.texture.even)
        near = distance_likelihood(seed_distance(segments, settings.seed), settings.road.reach)
        road = segment_road(segments, layout[:, HORIZONTAL], near, even, settings.road)
        return {
            "likelihood": paint(road, labels),
            "layout": paint(layout.T, labels),
            "layout_labels": paint(decide_layout(layout, settings.labeller), labels),
            "texture": paint(even, labels),
            "uniformity": paint(uniformity, labels),
            "fused_plane": fused,
            "saturated": clipped,
            "distance": paint(near, labels),
            "place": paint(road_place(segments.row, segments.column, settings.road.place), labels),
            "segments": labels,
        }

    return at_working_size(analyse, settings.working)


ENTRIES = (
    Entry(
        "fusion",
        "naive Bayes of layout, texture, distance, place and look: the best we know",
        FusionSettings,
        _fusion,
    ),
)
