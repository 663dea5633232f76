"""The benchmarks: the turns that contestants take."""

from scripts import bench


def test_contestants_take_turns_and_a_ratio_is_that_of_the_rounds() -> None:
    called: list[str] = []
    calls = {name: lambda name=name: called.append(name) for name in "ab"}

    times = bench.interleaved(calls, 2)

    assert {name: len(values) for name, values in times.items()} == {"a": 2, "b": 2}
    assert "".join(called) == "abba" * 2
    assert bench.ratio([2.0, 1.0, 9.0], [1.0, 1.0, 3.0]) == 2.0
