"""An evaluation of the oracle on rendered streets."""

from dataclasses import replace

import pytest

from roadtorch.data.catalogue import open_dataset
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.result import Evaluation
from tests.oracle import ORACLE, register_oracle, write_set


@pytest.fixture(scope="session")
def oracle_run(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """Evaluate on three groups and two conditions; one image fails."""
    register_oracle()
    root = write_set(tmp_path_factory.mktemp("set") / "camvid")
    (root / "train" / "0001TP_0.png").write_bytes(b"")
    dataset = open_dataset("camvid", root)
    items = tuple(
        replace(item, conditions=("rain",) if item.group == "0006R0" else ("day",))
        for item in dataset.items
    )
    run = evaluate(replace(dataset, items=items), [ORACLE], settings={"doubt": 0.2})
    (failure,) = run.failures
    return replace(run, failures=[replace(failure, reason="is empty")])
