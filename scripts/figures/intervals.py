"""95 % intervals of what the papers pool or average over all images of a set."""

import torch

from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.result import Interval
from roadtorch.evaluation.tally import Tally
from roadtorch.evaluation.uncertainty import (
    BOOTSTRAP_SEED,
    bootstrap_weights,
    percentile_interval,
    pool_replicates,
)


def pooled_interval(tally: Tally, measure: Measure) -> Interval:
    """Return the interval of a score of pooled pixels; images are drawn from the whole set."""
    images, generator = tally.table(), torch.Generator().manual_seed(BOOTSTRAP_SEED)
    weights = bootstrap_weights(len(images.names), generator)
    values = measure.formula(pool_replicates(images, 0.5, weights))
    assert isinstance(values, torch.Tensor)
    return percentile_interval(values)


def mean_interval(values: torch.Tensor) -> Interval:
    """Return the interval of the mean of values (n,), each of one image."""
    weights = bootstrap_weights(len(values), torch.Generator().manual_seed(BOOTSTRAP_SEED))
    return percentile_interval(weights.double() @ values.double() / len(values))
