"""What is learned from one picture: preprocessing, dictionary and feature maps (P1, II.A, B)."""

from dataclasses import dataclass

from torch import Tensor

from roadtorch.ufl.features import DictionarySettings, learn_dictionary, white_patches
from roadtorch.ufl.maps import FeatureMaps, MapSettings, select_maps
from roadtorch.ufl.preprocess import Smoothing, equalised


@dataclass(frozen=True)
class LearnedFeatures:
    """What is learned from one picture, before any road is looked for.

    even: (3,H,W), equalised. dictionary: (K,d). maps: the selected feature maps.
    """

    even: Tensor
    dictionary: Tensor
    maps: FeatureMaps


def learn_features(
    image: Tensor, smoothing: Smoothing, dictionary: DictionarySettings, maps: MapSettings
) -> LearnedFeatures:
    """Preprocessing, dictionary and feature maps of an image (3,H,W) (P1, sections II.A, B)."""
    even = equalised(image, smoothing)
    patches = white_patches(even, dictionary)
    bases = learn_dictionary(patches, dictionary)
    size = (image.shape[1] - dictionary.side + 1, image.shape[2] - dictionary.side + 1)
    return LearnedFeatures(even, bases, select_maps(patches, bases, size, maps))
