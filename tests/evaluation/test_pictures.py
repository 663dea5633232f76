"""The rows of single pictures: whose they are, and what they hold."""

import math

import pytest
import torch

from roadtorch.detector import Detection
from roadtorch.evaluation.summary import picture_rows
from roadtorch.report.files import rows_csv
from tests.evaluation.conftest import GROUPS, counted, summarised


def test_a_row_holds_f_and_iou_of_the_mask_and_its_trust(dataset, scenes):
    first = next(iter(scenes))

    def look(image, item):
        mask = torch.zeros(48, 64, dtype=torch.bool)
        mask[24:] = True
        return Detection(mask.float(), mask, {}, 0.625 if item.name == first else None)

    tally = counted(dataset, look)
    rows = {row.image: row for row in picture_rows("it", tally, summarised(tally))}

    road, seen = scenes[first].road & ~scenes[first].void, ~scenes[first].void
    hits, decided = int((road[24:]).sum()), int(seen[24:].sum())
    assert rows[first].f_mask == pytest.approx(2 * hits / (decided + int(road.sum())))
    assert rows[first].iou_mask == pytest.approx(hits / (decided + int(road.sum()) - hits))
    assert [row.trust for row in rows.values() if row.image == first] == [0.625]
    assert all(math.isnan(row.trust) for name, row in rows.items() if name != first)
    lines = rows_csv(list(rows.values()), (), [GROUPS[1]]).splitlines()
    assert lines[0] == ("image,group,detector,auc,maxf,threshold,f,f_mask,iou_mask,trust,ms,status")
    assert ",0.625000," in lines[1]
    assert [line.endswith(",left out") for line in lines[1:]] == [
        row.group == GROUPS[1] for row in rows.values()
    ]
