from roadtorch.detectors.catalogue import detector_groups, list_detectors
from roadtorch.imaging.color import PLANES, REPRESENTATIONS
from roadtorch.oneclass import CLASSIFIERS
from tests.command import Call


def test_detectors_lists_every_one_with_its_summary(call: Call) -> None:
    result = call("detectors")

    lines = result.stdout.splitlines()
    assert result.exit_code == 0
    assert [line.split()[0] for line in lines if line[0] != " "] == list(detector_groups())
    assert all(len(line.split()) > 1 for line in lines)
    assert max(map(len, lines)) <= 100


def test_the_one_class_grid_is_listed_by_its_options(call: Call) -> None:
    text = call("detectors").stdout

    _, *options = text[text.index("oneclass:<classifier>") : text.index("prior:rows")].split(
        "\n  <"
    )
    listed = {first: words for first, *words in map(str.split, options)}
    assert listed == {"classifier>": [*CLASSIFIERS], "planes>": [*REPRESENTATIONS]}
    assert "310 detectors, 'oneclass:*' lists them" in " ".join(text.split())


def test_wildcards_list_the_detectors_they_fit(call: Call) -> None:
    every, some = (call("detectors", name).stdout.splitlines() for name in ("oneclass:*", "cpf*"))

    names = [line.split()[0] for line in every if line[0] != " "]
    assert names == list_detectors("oneclass:*")
    assert len(names) == 310
    assert [line.split()[0] for line in some] == ["cpf", "cpf:squares", "cpf:v2"]


def test_a_detectors_own_defaults_of_shared_settings_are_told(call: Call) -> None:
    """Both have the working size as a group, of which one has another default."""
    found = {}
    for name in ("cpf", "oneclass:gaussian:HS"):
        lines = call("detectors", name).stdout.splitlines()
        found[name] = next(line.split()[2] for line in lines if line.startswith("working.pixels"))

    assert found == {"cpf": "76800", "oneclass:gaussian:HS": "307200"}


def test_detectors_name_explains_its_settings(call: Call) -> None:
    result = call("detectors", "cpf")

    cells = {line.split()[0]: line for line in result.stdout.splitlines() if line}
    assert "number" in cells["threshold"]
    assert "≥ 0, ≤ 1" in cells["threshold"]
    assert "drop | keep" in cells["isolated"]
    assert "64" in cells["texture.bins"]
    assert "columns" in cells["seed_area.width"]


def test_an_unknown_detector_is_wrong_usage(call: Call) -> None:
    result = call("detectors", "cfp")

    assert result.exit_code == 2
    assert result.stderr.startswith("roadtorch: error: cfp: unknown detector (did you mean cpf")


def test_planes_lists_planes_and_representations(call: Call) -> None:
    result = call("planes")

    planes, representations = result.stdout.strip().split("\n\n")
    assert [line.split()[0] for line in planes.splitlines()[1:]] == list(PLANES)
    listed = [line.split() for line in representations.splitlines()[1:]]
    assert {name: tuple(parts) for name, *parts in listed} == dict(REPRESENTATIONS)


def test_settings_fit_a_hundred_columns_and_none_is_lost(call: Call) -> None:
    lines = call("detectors", "fusion").stdout.splitlines()

    assert max(map(len, lines)) <= 100
    listed = {line.split()[0] for line in lines if line[:1].strip()}
    assert {
        "seed_area.height",
        "texture.bins",
        "working.pixels",
        "learned.weight",
    } <= listed


def test_the_hue_is_said_to_be_circular(call: Call) -> None:
    said = [line.split()[0] for line in call("planes").stdout.splitlines() if "circular" in line]

    assert said == ["H"]
