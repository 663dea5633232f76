"""One-class colour classification (P3): learn the colours of road from one image.

from roadtorch.oneclass import CLASSIFIERS, make_axes, fit

fitted = fit(CLASSIFIERS["robust_gaussian"], samples, make_axes(("H", "S")))
fitted.likelihood(pixels)
"""

from roadtorch.oneclass import boundary, density, histogram, mixture, neighbours, reconstruction
from roadtorch.oneclass.axes import Axes, make_axes
from roadtorch.oneclass.base import Classifier, ClassifierSettings, FittedClassifier, fit

CLASSIFIERS: dict[str, Classifier] = {
    classifier.name: classifier
    for classifier in (
        neighbours.NN,
        *histogram.HISTOGRAMS,
        *density.GAUSSIANS,
        *mixture.MIXTURES,
        boundary.SVDD,
        reconstruction.PCA,
        boundary.MPM,
        neighbours.MST,
        boundary.DLP,
        reconstruction.K_MEANS,
        reconstruction.K_CENTRES,
    )
}
"""The 17 classifiers of P3 by name, in the order of its Table III."""

__all__ = [
    "CLASSIFIERS",
    "Axes",
    "Classifier",
    "ClassifierSettings",
    "FittedClassifier",
    "fit",
    "make_axes",
]
