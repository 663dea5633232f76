"""Settings of a training run: one TOML file for one kind of network."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from roadtorch.base.errors import ConfigError, unknown_name_error
from roadtorch.base.settings import Settings, build_settings
from roadtorch.imaging.resize import WorkingSize
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.backbone_network import BackboneNetworkSettings, UpperRows
from roadtorch.layout.labeller import LabellerSettings
from roadtorch.layout.patch_network import PatchNetworkSettings
from roadtorch.layout.pretrained import IMAGENET

Fraction = Annotated[float, Field(ge=0, le=1)]

InputSide = Annotated[int, Field(ge=32, le=1024, multiple_of=32)]
InputSize = Annotated[tuple[InputSide, InputSide], Field(strict=False)]
"""Height and width of a network's input."""


class Descent(Settings):
    """Gradient descent."""

    method: Literal["sgd", "adam"] = Field(
        default="sgd", description="plain gradient descent as in Álvarez 2012, or Adam"
    )
    learning_rate: float = Field(default=0.1, gt=0, le=100, description="initial learning rate")
    momentum: float = Field(default=0.0, ge=0, lt=1, description="momentum of sgd")
    weight_decay: Fraction = Field(default=0.0, description="weight decay of all weights")
    schedule: Literal["constant", "cosine"] = Field(
        default="constant", description="learning rate: constant, or cosine down to 0"
    )
    warm_up: Fraction = Field(
        default=0.0, description="fraction of the epochs over which the learning rate rises"
    )
    batch: int = Field(default=128, ge=1, le=10**6, description="samples per step, approximately")
    ema: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="decay of the exponential moving average of the weights that is written; "
        "0 writes the last weights",
    )

    def learning_rate_at(self, progress: float) -> float:
        """Return the learning rate after a fraction ``progress`` of the epochs."""
        rate = self.learning_rate * min(1.0, (progress + 1e-3) / max(self.warm_up, 1e-3))
        return (
            rate if self.schedule == "constant" else rate * (1 + math.cos(math.pi * progress)) / 2
        )


class Stopping(Settings):
    """End of training."""

    epochs: int = Field(default=60, ge=1, le=10**5, description="largest number of epochs")
    rule: Literal["plateau", "epochs"] = Field(
        default="plateau",
        description="stop when an epoch's loss falls by ``min_delta`` or less (Álvarez 2012), or "
        "after the last epoch",
    )
    min_delta: float = Field(
        default=0.001,
        ge=0,
        le=10,
        description="largest fall of the mean loss that counts as a plateau",
    )
    patience: int = Field(
        default=3, ge=1, description="epochs without a higher F on held-out images, then stop"
    )

    def is_reached(self, losses: Sequence[float]) -> bool:
        """Return whether training ends after epochs with these mean losses, in their order."""
        fall = losses[-2] - losses[-1] if len(losses) > 1 else math.inf
        return (self.rule == "plateau" and fall <= self.min_delta) or len(losses) >= self.epochs


class PatchCentres(Settings):
    """Centres of patches: at and around the centroids of superpixels. P2, section 3.1."""

    extra: int = Field(default=4, ge=0, le=64, description="extra patches around each centroid")
    radius: float = Field(
        default=4.0, ge=0, le=100, description="distance from the centroid, pixels at working size"
    )


class CorrectionWeight(Settings):
    """Weight of human corrections against machine labels, where a run has some."""

    weight: float = Field(
        default=1.0,
        gt=0,
        le=100,
        description="loss weight of a corrected pixel; machine-labelled ones weigh at most 1",
    )
    fraction: float = Field(
        default=0.5, gt=0, le=1, description="fraction of training samples from corrected images"
    )
    half_rate_images: float = Field(
        default=0.0,
        ge=0,
        le=10**6,
        description="n corrected images scale the learning rate by n / (n + half_rate_images)",
    )
    held_out: Fraction = Field(
        default=0.0,
        description="fraction of the corrected images that does not train, but "
        "decides when to stop: whole recordings where they fit",
    )
    separator: str = Field(
        default="_", description="text before the frame number in names; empty for no recordings"
    )


class CommonTraining(Settings):
    """Settings that all kinds of training have."""

    random_seed: int = Field(default=0, ge=0, le=2**31, description="seed of all random numbers")
    initial_weights: str = Field(
        default="",
        description="weight file to start from, or the name of a shipped one such as cnn-7; "
        "imagenet for a backbone with ImageNet's weights; empty for new weights",
    )

    @property
    def is_new(self) -> bool:
        """Return whether the network is new: no run has trained it before."""
        return self.initial_weights in ("", IMAGENET)


class PatchTraining(CommonTraining):
    """Training of a patch network, as P2 trains CNN-7."""

    name: ClassVar[str] = "patches"
    network: PatchNetworkSettings = PatchNetworkSettings()
    superpixels: Superpixels = Superpixels()
    labeller: LabellerSettings = LabellerSettings()
    centres: PatchCentres = PatchCentres()
    shuffle_images: int = Field(
        default=16, ge=1, le=10**4, description="images whose patches are shuffled together"
    )
    passes: int = Field(
        default=4,
        ge=1,
        le=100,
        description="visits to an image in an epoch, each with a different part of its patches",
    )
    descent: Descent = Descent()
    stopping: Stopping = Stopping()


class Teacher(Settings):
    """Source of the targets of whole images."""

    detector: str = Field(
        default="fusion", description="teacher, a detector with a layout among its cues"
    )
    weights: str = Field(
        default="", description="weights of the teacher's network; empty for the shipped ones"
    )
    working: WorkingSize = WorkingSize()
    combine: Literal["agreement", "teacher"] = Field(
        default="agreement",
        description="with initial weights: mean of teacher and initial network where they agree, "
        "or teacher alone",
    )
    margin: float = Field(
        default=0.5,
        ge=0,
        lt=1,
        description="least lead of the best class for a pixel's layout to count",
    )
    targets: Literal["hard", "soft"] = Field(
        default="hard",
        description="soft: layout potentials, road likelihood; hard: best class, road 0 or 1",
    )


class HeadWeights(Settings):
    """Weights of the losses of road and ego car against that of the layout."""

    road: float = Field(default=1.0, ge=0, le=100, description="weight of the road's loss")
    ego: float = Field(default=0.5, ge=0, le=100, description="weight of the ego car's loss")


class GeometryAugmentation(Settings):
    """Random geometry of whole images."""

    mirror: Fraction = Field(default=0.5, description="fraction of the images that are mirrored")
    scale: float = Field(default=0.25, ge=0, le=2, description="zoom from e^-scale to e^scale")
    stretch: float = Field(
        default=0.1, ge=0, le=2, description="stretch of the width from e^-stretch to e^stretch"
    )
    rotation: float = Field(default=4.0, ge=0, le=90, description="largest rotation, degrees")
    translation: Fraction = Field(default=0.1, description="largest shift, fraction of the size")
    crop_probability: Fraction = Field(
        default=0.0, description="fraction of images cropped at the top: the horizon is higher"
    )


class Augmentation(Settings):
    """Augmentation of whole images: geometry, and the fractions of images that get an effect."""

    geometry: GeometryAugmentation = GeometryAugmentation()
    surface: Fraction = Field(
        default=0.0, description="random colour and grain, for road and other ground separately"
    )
    shadow: Fraction = Field(default=0.0, description="a hard shadow with straight edges")
    ego_car: Fraction = Field(
        default=0.0, description="an ego car, cut out of footage and pasted over the lower edge"
    )
    ego_growth: float = Field(
        default=0.7, ge=0, le=3, description="an ego car's height is scaled by up to e^ego_growth"
    )
    weather: Fraction = Field(
        default=0.0, description="fog, snow beside the road, a wet road or rain, equally likely"
    )
    night: Fraction = Field(default=0.0, description="night, lit by headlights and a few lamps")
    underexposed: Fraction = Field(default=0.0, description="darkened to a mean of 0.05 to 0.2")
    blurred: Fraction = Field(default=0.0, description="blurred over 3×3 pixels")

    def scale_effects(self, factor: float) -> "Augmentation":
        """Return the settings with the fractions of images that get an effect times a factor."""
        fractions = self.model_dump(exclude={"geometry", "ego_growth"})
        return self.model_copy(update={name: value * factor for name, value in fractions.items()})


class TrainingRound(Settings):
    """A round of a self-training."""

    epochs: int = Field(default=1, ge=1, le=10**5, description="epochs of the round")
    learning_rate: float = Field(
        default=0.0,
        ge=0,
        le=100,
        description="learning rate before the round's warm-up and schedule; 0: that of [descent]",
    )
    backbone_factor: float = Field(
        default=1.0, ge=0, le=10, description="factor on the backbone's learning rate; 0: frozen"
    )
    target: float = Field(
        default=0.0, ge=0, lt=1, description="fraction of training samples that are target images"
    )
    effects: Fraction = Field(
        default=1.0, description="factor on the fractions of [augmentation] but its geometry"
    )


class SourceImages(Settings):
    """Use of source images: rendered, with truth."""

    balance: Fraction = Field(
        default=0.5, description="a kind of n images has the sampling weight n^(1 - balance)"
    )
    border: float = Field(
        default=3.0,
        ge=0,
        le=100,
        description="weight added where road meets something vertical; if it is not 0, labels of "
        "target images do not count there",
    )


class TargetImages(Settings):
    """Use of target images: real ones, labelled by the network of the rounds before."""

    balance: Fraction = Field(
        default=0.2, description="a recording of n images has the sampling weight n^(1 - balance)"
    )
    separator: str = Field(
        default="_", description="text before the frame number in names; empty for no recordings"
    )
    margin: float = Field(
        default=0.2, ge=0, lt=1, description="least lead of the best class for layout to count"
    )
    road_margin: float = Field(
        default=0.1, ge=0, lt=1, description="least |2p - 1| for a pixel's road label p to count"
    )


class SelfTraining(CommonTraining):
    """Training of the network of `fusion` on rendered worlds and on images that it labels. Ours.

    Unsupervised domain adaptation by self-training: in the first round the network learns from the
    truth of source images; before each later one the detector with that network labels the target
    images.
    """

    name: ClassVar[str] = "self-training"
    network: BackboneNetworkSettings = BackboneNetworkSettings()
    rounds: tuple[TrainingRound, ...] = Field(
        strict=False, default=(TrainingRound(),), min_length=1, max_length=16
    )
    source: SourceImages = SourceImages()
    target: TargetImages = TargetImages()
    augmentation: Augmentation = Augmentation()
    heads: HeadWeights = HeadWeights()
    samples_per_epoch: int = Field(default=2000, ge=1, le=10**7, description="images of an epoch")
    sizes: tuple[InputSize, ...] = Field(
        strict=False,
        default=((224, 256),),
        min_length=1,
        max_length=16,
        description="height and width of the network's input, one sampled for each batch",
    )
    upper_rows: tuple[UpperRows, ...] = Field(
        strict=False,
        default=(0.0,),
        min_length=1,
        max_length=16,
        description="values of network.upper_rows, one sampled for each batch",
    )
    frozen_blocks: int = Field(
        default=0, ge=0, le=32, description="first blocks of the backbone that never learn"
    )
    descent: Descent = Descent(method="adam", learning_rate=0.001, schedule="cosine", batch=16)


class ImageTraining(CommonTraining):
    """Training of a whole-image network with heads for layout, road and ego car. Ours."""

    name: ClassVar[str] = "images"
    corrections: CorrectionWeight = CorrectionWeight()
    network: BackboneNetworkSettings = BackboneNetworkSettings()
    teacher: Teacher = Teacher()
    augmentation: Augmentation = Augmentation()
    heads: HeadWeights = HeadWeights()
    samples_per_epoch: int = Field(
        default=0, ge=0, le=10**7, description="images of an epoch; 0 for all"
    )
    descent: Descent = Descent(method="adam", learning_rate=0.003, schedule="cosine", batch=16)
    stopping: Stopping = Stopping(epochs=15, rule="epochs")


Training = PatchTraining | ImageTraining | SelfTraining

TRAINING_KINDS: dict[str, type[Training]] = {
    kind.name: kind for kind in (PatchTraining, ImageTraining, SelfTraining)
}


def build_training(values: dict[str, Any]) -> Training:
    """Build the settings of a run from nested values; ``kind`` is a key of ``TRAINING_KINDS``.

    Raises ConfigError for an unknown kind, an unknown key or a value that is not allowed.
    """
    nested = dict(values)
    kind = str(nested.pop("kind", PatchTraining.name))  # str, as a list could not be looked up
    if kind not in TRAINING_KINDS:
        raise unknown_name_error("kind of training", kind, TRAINING_KINDS)
    settings = build_settings(TRAINING_KINDS[kind], nested)
    if isinstance(settings, PatchTraining) and settings.initial_weights == IMAGENET:
        message, hint = f"is {IMAGENET}, but patches have no backbone", "leave it out"
        raise ConfigError("initial_weights", message, hint)
    if isinstance(settings, SelfTraining) and settings.rounds[0].target and settings.is_new:
        message = "is not 0, but no network has learned yet that could label them"
        raise ConfigError("rounds.0.target", message, "learn from source images first")
    if isinstance(settings, ImageTraining) and (fraction := settings.augmentation.ego_car):
        message = f"is {fraction:g}, but only rendered worlds show where an ego car is"
        raise ConfigError("augmentation.ego_car", message, "leave it out")
    return settings


def as_values(settings: Training) -> dict[str, object]:
    """Return nested values from which ``build_training`` builds the same settings."""
    return {"kind": settings.name, **settings.model_dump(mode="json")}
