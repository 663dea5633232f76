"""The tables of README and docs that scripts/readme_figures.py writes from records."""

import re
from collections.abc import Mapping
from typing import NamedTuple

Records = Mapping[str, float | str]

MINUS = "\N{MINUS SIGN}"
LEARNED = ("fusion", "fusion:large", "fusion:scratch", "fusion:untrained")
FUSIONS = (*LEARNED, "fusion:paper")
ROAD = (
    *FUSIONS,
    *("layout:cnn-7", "layout:paper", "labeller", "ufl", "ufl:original"),
    *("cpf", "cpf:v2", "cpf:squares", "grey-uniformity", "lbp", "prior:uniform"),
)
TIMED = (
    *("fusion", "fusion:large", "fusion:scratch", "fusion:untrained", "fusion:paper"),
    *("labeller", "layout:cnn-7", "cpf", "ufl", "ufl:original"),
    *("kmeans-road", "vanishing-point"),
)
SLOW = ("fusion", "kmeans-road", "vanishing-point")


def restated(figure: str, value: float | str) -> str:
    """A value in the words of an old figure: its digits, its sign, its percent.

    ".827" and .8312 → ".831"; "1,318" and 55 → "55"; "470,000" and 474,373 → "474,000"; "18 %"
    and .2 → "20 %"; "`a`" and "b" → "`b`". A minus is a true one.
    """
    if figure.startswith("`"):
        return f"`{value}`"
    percent = re.search(r"\s?%$", figure)
    digits = figure.removesuffix(percent[0] if percent else "")
    places = len(digits.partition(".")[2])
    if not places and (zeros := len(digits) - len(digits.rstrip("0,"))) >= 3:
        places = -3 * (zeros // 4) if "," in digits else -zeros
    number = round(float(value) * (100 if percent else 1), places)
    text = f"{abs(number):{',' if ',' in figure else ''}.{max(places, 0)}f}"
    if places > 0 and re.match(rf"[+{MINUS}-]?\.", figure):
        text = text.removeprefix("0")
    signed = figure[0] in f"+-{MINUS}"
    sign = MINUS if number < 0 else "+" if signed else ""
    return sign + text + (percent[0] if percent else "")


class Table(NamedTuple):
    """header: the columns. rows: what stands first → the word for {row}, from "@" on for {at}.

    cells: of the further columns, with ``[[name|style]]`` for a record in the style of a figure
    (".000" where none is given; "ci": with its interval; a dash where a name with "?" is of
    none). sort: the record by which rows fall.
    """

    header: str
    rows: Mapping[str, str]
    cells: str
    sort: str = ""

    def __call__(self, known: Records) -> str:
        """Markdown lines; KeyError for a missing record."""

        def cell(match: re.Match[str]) -> str:
            key, _, style = match[1].removeprefix("?").partition("|")
            if match[1].startswith("?") and key not in known:
                return "–"
            if style != "ci":
                return restated(style or ".000", known[key])
            values = (restated(".000", known[name]) for name in (key, f"{key}.low", f"{key}.high"))
            return "{} ({}–{})".format(*values)

        rows = list(self.rows.items())
        if self.sort:
            rows.sort(key=lambda row: -float(known[_with_word(self.sort, row[1])]))
        lines = [self.header, " | ".join(["---"] * (self.header.count("|") + 1))]
        for first, word in rows:
            cells = re.sub(r"\[\[(.+?)\]\]", cell, _with_word(self.cells, word))
            lines.append(f"{first} | {cells}")
        return "".join(f"| {line} |\n" for line in lines)


def _with_word(text: str, word: str) -> str:
    row, at, group = word.partition("@")
    return text.replace("{row}", row).replace("{at}", at + group)


def _named(*names: str) -> dict[str, str]:
    return {f"`{name}`": name for name in names}


def _cells(run: str, *keys: str) -> str:
    return " | ".join(f"[[{run}.{{row}}.{key}]]" for key in keys)


DRIVES = ("0001TP", "0006R0", "0016E5")
BASELINES = ("prior:mean", "prior:rows", "prior:triangle")
PEERS = {
    "road-segmentation-adas-0001": "road_segmentation_adas_0001",
    "ESPNetv2": "espnetv2_cityscapes_half",
    "TwinLiteNet": "twinlitenet",
    "TwinLiteNet+ nano": "twinlitenetplus_nano",
    "TwinLiteNet+ small": "twinlitenetplus_small",
    "ESPNet": "espnet_cityscapes",
}
"""Supervised networks by the names of scripts/peers.py's files."""

CAMERAS = (
    *("cityscapes", "comma10k", "dn_bdd_drivable", "dn_cassed", "dn_cat", "dn_cityscapes"),
    *("dn_idd", "dn_makassar", "dn_mapillary", "dn_mcubes", "dn_nuimages", "dn_tas500"),
    *("kitti_semantics", "ycor"),
)
CONDITIONS = ("day", "offroad", "rain", "bonnet", "underexposed", "shadow", "dusk", "night")
LAYOUTS = ("labeller", "layout:cnn-7", "layout:paper")
CLASSES = ("sky", "vertical", "horizontal")
MEASURES = "AUC pooled | AUC mean | AP | IoU | EER | Brier | F of mask | ECE"
KEYS = ("auc_pooled", "auc_mean", "ap", "iou", "eer", "brier", "f_mask", "ece")

TABLES: Mapping[str, Table] = {
    "front": Table(
        "detector | fourteen cameras, F | the worst of them | CamVid, MaxF | IDD, MaxF",
        {
            "`fusion`": "fusion",
            "`fusion:large`, two networks and a closer look": "fusion:large",
            "`fusion:scratch`, whose network has seen no label of any kind": "fusion:scratch",
            "`fusion:untrained`, which needs no weights": "fusion:untrained",
            "`ufl`, after Zhang et al.": "ufl",
            "`fusion:paper`, Álvarez et al. as printed": "fusion:paper",
            "`prior:rows`: lower is likelier, never looks at the picture": "prior:rows",
        },
        f"{_cells('many', 'f_mask', 'f_mask.worst')} | [[camvid.{{row}}.maxf]] | "
        "[[idd.{row}.maxf]]",
    ),
    "camvid-road": Table(
        f"detector | {' | '.join(f'MaxF {name}' for name in DRIVES)} | mean (95 %) | {MEASURES}",
        _named(*ROAD, *BASELINES),
        f"{_cells('camvid', *(f'maxf@{name}' for name in DRIVES))} | [[camvid.{{row}}.maxf|ci]] | "
        f"{_cells('camvid', *KEYS)}",
        "camvid.{row}.maxf",
    ),
    "idd-road": Table(
        f"detector | MaxF (95 %) | {MEASURES}",
        _named(*ROAD, *BASELINES),
        f"[[idd.{{row}}.maxf|ci]] | {_cells('idd', *KEYS)}",
        "idd.{row}.maxf",
    ),
    "road": Table(
        "detector | CamVid, MaxF (95 %) | F | IoU | IDD, MaxF (95 %) | F | IoU",
        _named(*LEARNED, "ufl", "ufl:original", "fusion:paper", *BASELINES[:2]),
        " | ".join(
            f"[[{run}.{{row}}.maxf|ci]] | {_cells(run, 'f_mask', 'iou')}"
            for run in ("camvid", "idd")
        ),
        "camvid.{row}.maxf",
    ),
    "ufl": Table(
        "detector | CamVid: F of mask | MaxF (95 %) | IDD: F of mask | MaxF (95 %)",
        _named("ufl", "ufl:original", *BASELINES),
        " | ".join(
            f"[[{run}.{{row}}.f_mask]] | [[{run}.{{row}}.maxf|ci]]" for run in ("camvid", "idd")
        ),
    ),
    "pairs": Table(
        "minus `fusion` | CamVid, MaxF (95 %) | IDD, MaxF (95 %)",
        _named(*LEARNED[1:], "ufl", "prior:mean"),
        " | ".join(
            f"[[?{run}.{{row}}.maxf.less|+.000]] ([[?{run}.{{row}}.maxf.less.low|+.000]] to "
            f"[[?{run}.{{row}}.maxf.less.high|+.000]])"
            for run in ("camvid", "idd")
        ),
    ),
    "camvid-roc": Table(
        "detector | AUC pooled | AUC mean over pictures | over `lbp` | IDD, AUC pooled",
        _named(
            *("lbp", "grey-uniformity", "cpf", "cpf:v2", "layout:paper", "fusion:paper"),
            *("layout:cnn-7", "fusion"),
        ),
        f"{_cells('camvid', 'auc_pooled', 'auc_mean')} | "
        "[[camvid.{row}.auc_pooled.over_lbp|+0 %]] | [[idd.{row}.auc_pooled]]",
    ),
    "layout-recall": Table(
        "detector, pictures | sky | vertical | horizontal | mean | void as vertical | accuracy | "
        "mean, labelled | labelled",
        {
            f"`{name}`, {title}": f"{run}.{name}{at}"
            for name in LAYOUTS
            for run, at, title in (
                *(("camvid", f"@{drive}", drive) for drive in DRIVES),
                ("camvid", "", "CamVid"),
                ("idd", "", "IDD"),
            )
        },
        "".join(
            f"[[{{row}}.layout.{key}{{at}}]] | "
            for key in (*CLASSES, "mean", "void_as_vertical.mean", "accuracy")
        )
        + "[[?{row}.layout.labelled.mean{at}]] | [[?{row}.layout.labelled_share{at}|0 %]]",
    ),
    "layout-confusion": Table(
        "detector, pictures | sky → sky / vertical / horizontal | vertical → | horizontal →",
        {
            f"`{name}`, {title}": f"{run}.{name}"
            for name in LAYOUTS
            for run, title in (("camvid", "CamVid"), ("idd", "IDD"))
        },
        " | ".join(
            " / ".join(f"[[{{row}}.layout.confusion.{true}.{decided}]]" for decided in CLASSES)
            for true in CLASSES
        ),
    ),
    "slow": Table(
        "detector | CamVid, MaxF (95 %) | CamVid, F of mask | IDD, MaxF (95 %) | IDD, F of mask",
        _named(*SLOW, "prior:rows"),
        " | ".join(
            f"[[{run}.{{row}}.maxf|ci]] | [[{run}.{{row}}.f_mask]]"
            for run in ("camvid-slow", "idd-slow")
        ),
        "camvid-slow.{row}.maxf",
    ),
    "speed": Table(
        "detector | ms | of LRASPP",
        {
            **_named(*TIMED),
            "LRASPP (torchvision)": "LRASPP",
            "slic, ours": "slic",
            "slic of scikit-image": "slic-skimage",
        },
        "[[bench.{row}.ms|0.0]] | [[bench.{row}.of_lraspp|.00]]",
    ),
    "many-detectors": Table(
        "detector | F (95 %) | worst camera, F | MaxF | IoU | ECE",
        _named(*LEARNED, "labeller", "ufl", "fusion:paper", "prior:rows"),
        f"[[many.{{row}}.f_mask|ci]] | {_cells('many', 'f_mask.worst', 'maxf', 'iou_mask', 'ece')}",
    ),
    "many-cameras": Table(
        "camera | F | MaxF | IoU | `fusion:untrained`, F | `prior:rows`, MaxF",
        {**{name: f"@{name}" for name in CAMERAS}, "mean of all": ""},
        "[[many.fusion.f_mask{at}]] | [[many.fusion.maxf{at}]] | [[many.fusion.iou_mask{at}]] | "
        "[[many.fusion:untrained.f_mask{at}]] | [[many.prior:rows.maxf{at}]]",
    ),
    "peers": Table(
        "detector or network | F | worst camera, F | MaxF | ms",
        {"`fusion`": "fusion", "`fusion:large`": "fusion:large", **PEERS},
        f"{_cells('peers', 'f_mask', 'f_mask.worst', 'maxf')} | [[peers.{{row}}.ms|0]]",
        sort="peers.{row}.f_mask",
    ),
    "peers-cameras": Table(
        " | ".join(["camera", "`fusion`", "`fusion:large`", *PEERS]),
        {**{name: f"@{name}" for name in CAMERAS}, "mean of all": ""},
        " | ".join(
            f"[[peers.{name}.f_mask{{at}}]]" for name in ("fusion", "fusion:large", *PEERS.values())
        ),
    ),
    "export": Table(
        "its network / the detector | F | worst camera, F | MaxF | ECE | boundary F",
        _named("fusion", "fusion:large"),
        " | ".join(
            f"[[export.maps:{{row}}.{key}]] / [[export.{{row}}.{key}]]"
            for key in ("f_mask", "f_mask.worst", "maxf", "ece", "boundary_f.0.00375")
        ),
    ),
    "many-conditions": Table(
        "condition | pictures | F | MaxF",
        {name: f"@{name}" for name in CONDITIONS},
        "[[many.fusion.images{at}|0]] | [[many.fusion.f_mask{at}]] | [[many.fusion.maxf{at}]]",
    ),
}
"""By the name that documents call them."""
