#!/usr/bin/env bash
# A first day of three people, each with a folder of their own: a roboticist with a clip and a bag,
# an engineer with arrays and ONNX, a researcher with a plug-in and a folder of folders.
#   bash scripts/first_day.sh [--env DIR] [CLIP]
# DIR is a virtual environment with roadtorch[video,bags,onnx]; one is made without it. CLIP is the
# roboticist's video of 10 s or more; a rendered one without it.
# Prints a transcript as first_minutes.sh does, and the seconds of each person.
set -euo pipefail
env='' clip=''
while [ $# -gt 0 ]; do
  case $1 in
    --env) env=$(cd "$2" && pwd) && shift 2 ;;
    *) clip=$(realpath "$1") && shift ;;
  esac
done
python=$(command -v "${PYTHON:-python3}")
source "$(dirname "${BASH_SOURCE[0]}")/venv.sh" # in the repository's root from here on
root=$PWD
source scripts/steps.sh
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT

if [ -z "$env" ]; then
  env=$place/env
  PYTHON=$python choose_index
  step 0 "$python" -m venv "$env"
  step 0 "$env/bin/pip" install --quiet ${INDEX[@]+"${INDEX[@]}"} -c constraints.txt \
    "$root[video,bags,onnx]"
fi
PATH=$env/bin:$PATH

begin() { # WHO: in a folder of their own
  echo
  echo "# --- $1"
  mkdir "$place/$1" && cd "$place/$1"
  began=$(date +%s.%N)
}

end() {
  echo "# $(basename "$PWD"): $(seconds_since "$began") s"
}

example() { # PAGE: the first Python of a tutorial, which a test runs
  awk '/^```/ { if (inside) exit; inside = /python/; next } inside' "$root/docs/tutorials/$1.md"
}

begin roboticist
if [ -z "$clip" ]; then
  example video >make_video.py
  step 0 python make_video.py
  clip=drive.mp4
fi
step 6 roadtorch camera "$clip" --frames 20 --out camera.toml
step 2 roadtorch infer "$clip" --camera camera.toml --end 2 --out roads
example ros >make_bag.py
step 0 python make_bag.py
step 2 roadtorch infer drive --save bag --out bags
step 1 roadtorch grid drive --height 1.4 --out grids
end

begin engineer
cat >arrays.py <<'PYTHON'
import cv2
from roadtorch import load_detector

pictures = [cv2.imread(f"street/scene_0{number}.png") for number in range(4)]
detector = load_detector("fusion", order="bgr")
for number, found in enumerate(detector.detect_many(pictures, jobs=2)):
    found.save(f"street_{number}.mask.png")
    print(found)
PYTHON
step 0 python -m roadtorch.testing.scenes --out street --count 4
step 4 python arrays.py
step 2 roadtorch export fusion --out road.onnx
step 0 python "$root/docs/examples/infer.py" road.onnx street maps '*.png'
step 2 roadtorch compare fusion maps --images street
end

begin researcher
mkdir plug-in
cat >plug-in/pyproject.toml <<'TOML'
[project]
name = "blueish"
version = "0.1"
[tool.setuptools]
py-modules = ["blueish"]
[project.entry-points."roadtorch.detectors"]
blueish = "blueish:ENTRY"
TOML
cat >plug-in/blueish.py <<'PYTHON'
from torch import nn

from roadtorch.detectors.detector import DetectorSettings, Entry


class Blueish(nn.Module):
    def __init__(self, settings):
        super().__init__()

    def forward(self, image):
        return {"likelihood": (0.5 + image[2] - image[0]).clamp(0, 1)}


ENTRY = Entry("blueish", "road has more blue than red", DetectorSettings, Blueish)
PYTHON
cat >check.py <<'PYTHON'
from blueish import ENTRY
from roadtorch.testing import check_detector

check_detector(ENTRY)
PYTHON
# Beside the environment, which may be somebody's.
step 0 python -m pip install --quiet --no-deps --target plugged ./plug-in
export PYTHONPATH=$PWD/plugged${PYTHONPATH:+:$PYTHONPATH}
step 0 python check.py
step 4 roadtorch detectors blueish
example score >front.py
sed 's/range(6)/range(6, 12)/' front.py >rear.py # other streets
for camera in front rear; do
  mkdir -p "$camera" "set/$camera" && (cd "$camera" && python "../$camera.py")
  mv "$camera/labelled/"* "set/$camera"
done
step 60 roadtorch evaluate folder set --detector blueish --detector fusion --montage 0 --out scores
end
