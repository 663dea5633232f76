"""Kill the correction page again and again while four people draw; nothing that it took is lost.

    python scripts/torture_annotate.py --kills 100 --seed 0

Each server meets KILL, TERM or INT at a random moment and the next one is started over the same
folder, at the same address. A writer sends acts, some of them twice, and notes those that were
answered with 200; what was not answered it sends again, as the page does. After each death every
log has to begin with what it held before, and to have every noted act once, in the writer's order.
An answer of 500, a temporary file at the end, and TERM or INT that do not end in their status are
faults, too. The exit status is 1 where there is one.
"""

import argparse
import http.client
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch.annotate.server import Address, bound_socket, keep_address
from roadtorch.base.atomic import LEFTOVER
from roadtorch.cli import main
from roadtorch.data.events import log_path, read_log
from roadtorch.testing.scenes import render_scene, write_picture
from scripts.torture import ASKED, SIGNALS, become, ended

WRITERS, PICTURES = 4, 3
USERS = ("ann", "bob")  # two writers for each
LONGEST = 1.5  # seconds that a server is left alone once it answers
PATIENCE = 20.0  # seconds for a start, and for an end that was asked for


def write_acts(place: Path, number: int, address: Address, seed: int) -> None:
    """Send acts until the file ``stop`` is there; each answer is a line of a file of its own."""
    chance, count, user = random.Random(seed), 0, USERS[number % len(USERS)]
    with (place / f"writer-{number}").open("w", buffering=1) as notes:
        while not (place / "stop").exists():
            picture, count = f"{chance.randrange(PICTURES)}.png", count + 1
            act = {
                "kind": "brush",
                "id": f"w{number}-{count:06}",
                "saying": chance.choice(("road", "not_road", "sky")),
                "points": [[chance.uniform(0, 64), chance.uniform(0, 48)] for _ in range(5)],
                "radius": 3.0,
            }
            told = 0
            while told != 200 and not (place / "stop").exists():
                told = sent(address, picture, user, act)
                print(told, picture, user, act["id"], file=notes)
                if told != 200:
                    time.sleep(0.02)
            if chance.random() < 0.1:
                sent(address, picture, user, act)


def sent(address: Address, picture: str, user: str, act: dict[str, object]) -> int:
    """Send one act; the status of the answer, 0 where none came."""
    connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=PATIENCE)
    try:
        headers = {"x-token": address.token, "host": f"127.0.0.1:{address.port}"}
        where = f"/api/event?name={picture}&user={user}"
        connection.request("POST", where, json.dumps(act), headers)
        answer = connection.getresponse()
        answer.read()
        return answer.status
    except (OSError, http.client.HTTPException):
        return 0
    finally:
        connection.close()


def noted(place: Path) -> list[list[str]]:
    """Every answer so far: status, picture, user, act."""
    files = sorted(place.glob("writer-*"))
    return [
        line.split() for file in files for line in file.read_text().splitlines(True) if "\n" in line
    ]


def faults_in(place: Path, before: dict[Path, bytes]) -> list[str]:
    """What the logs lack of what was acknowledged; ``before`` is brought up to date."""
    found, expected = [], {}
    for status, picture, user, act in noted(place):
        if status == "200":
            expected.setdefault((picture, user), {}).setdefault(act[:2], []).append(act)
    for (picture, user), writers in expected.items():
        path = log_path(place / "out", picture, user)
        log, data = read_log(path), path.read_bytes()
        ids = [event.id for event in log.events] if log else []
        if not data.startswith(before.get(path, b"")):
            found.append(f"{path.name} no longer begins as it did")
        before[path] = data[: data.rfind(b"\n") + 1]
        found += [f"{path.name} has {act} twice" for act, n in Counter(ids).items() if n > 1]
        for writer, acts in writers.items():
            present = [act for act in ids if act.startswith(writer) and act in set(acts)]
            if present != acts:
                found.append(f"{path.name} lacks {sorted(set(acts) - set(present))[:3] or 'order'}")
    return found


def started(place: Path, address: Address) -> int:
    """A server that answers; its number."""
    words = ["annotate", "pictures", "--out", "out", "--detector", "prior:rows"]
    signal.pthread_sigmask(signal.SIG_BLOCK, ASKED)
    child = os.fork()
    if child == 0:
        become(lambda: main(words), place)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKED)
    end = time.monotonic() + PATIENCE
    while sent(address, "nothing", "ann", {}) == 0:
        if time.monotonic() > end or ended(child, 0.01) is not None:
            raise SystemExit(f"the page did not start: {(place / 'told').read_text()}")
    return child


def torture(kills: int, seed: int, place: Path) -> tuple[Counter[str], list[str], int]:
    """The signals sent, the faults, and the acts that were acknowledged."""
    chance, told, faults, before = random.Random(seed), Counter[str](), [], {}
    for number in range(PICTURES):
        write_picture(place / "pictures" / f"{number}.png", render_scene(number, 48, 64))
    (place / "out").mkdir()
    with bound_socket(None, None) as free:
        address = Address(port=free.getsockname()[1], token="t" * 32)
    keep_address(place / "out", address)
    writers = []
    for number in range(WRITERS):
        if (child := os.fork()) == 0:
            become(
                lambda at=number: write_acts(place, at, address, seed + at), place, f"told-{number}"
            )
        writers.append(child)
    for at in range(kills + 1):
        server = started(place, address)
        time.sleep(chance.uniform(0, LONGEST))
        if at == kills:
            (place / "stop").touch()
            faults += [f"a writer ended with {one}" for one in map(ended, writers) if one != 0]
        number = chance.choice(SIGNALS) if at < kills else signal.SIGTERM
        os.kill(server, number)
        status = ended(server, PATIENCE)
        told[number.name] += 1
        if status not in (-number, 128 + number):
            said = " / ".join((place / "told").read_text(errors="replace").splitlines()[-4:])
            faults.append(f"{number.name} ended with {status}: {said}")
            if status is None:
                os.kill(server, signal.SIGKILL)
        faults += faults_in(place, before)
    answers = Counter(status for status, *_ in noted(place))
    faults += [
        f"{n} answers of {one}" for one, n in answers.items() if one not in ("200", "0", "503")
    ]
    faults += [
        f"{path.name} is left"
        for path in (place / "out").rglob("*")
        if LEFTOVER.fullmatch(path.name)
    ]
    return told, faults, answers["200"]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        signals, wrong, acts = torture(given.kills, given.seed, Path(temporary))
    shown = ", ".join(f"{count} {name}" for name, count in sorted(signals.items()))
    print(f"{shown}; {acts} acts acknowledged; {len(wrong)} faults")
    for fault in wrong:
        print(f"  {fault}")
    sys.exit(1 if wrong else 0)
