"""roadtorch evaluate: score detectors and baselines on labelled images."""

from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

import click

from roadtorch.cli.options import (
    CAMERA_OPTION,
    JOBS_OPTION,
    PATH,
    ROAD_OPTION,
    RUNTIME_OPTION,
    SETTING_OPTION,
    VOID_OPTION,
    CheckedCommand,
    command_line,
    suggest_candidates,
    suggest_datasets,
)

REPORT_FILES = ("metrics.json", "images.csv", "tables.md", "report.html", "montage.{}.jpg")

if TYPE_CHECKING:
    from roadtorch.evaluation.methods import Contender
    from roadtorch.evaluation.result import Evaluation, Failure
    from roadtorch.evaluation.tuning import ThresholdChoice


@click.command(cls=CheckedCommand)
@click.argument("dataset", shell_complete=suggest_datasets)
@click.argument("root", type=PATH)
@click.option("--split", help="Split of the data set; camvid: dev (default), train, val, test.")
@click.option(
    "--detector",
    "names",
    multiple=True,
    default=("fusion",),
    shell_complete=suggest_candidates,
    help="Detector, with wildcards ('cpf*'), or [NAME=]PATH of weights, a config or a folder of "
    "maps; may be repeated.",
)
@SETTING_OPTION
@CAMERA_OPTION
@click.option(
    "--against",
    shell_complete=suggest_candidates,
    help="Compare the others with this --detector. [the best one]",
)
@click.option("--tune", is_flag=True, help="Choose each detector's threshold; write OUT/NAME.toml.")
@click.option("--submit", is_flag=True, help="Write maps for KITTI's server instead (kitti-road).")
@click.option("--bev", is_flag=True, help="Score in bird's-eye view (kitti-road).")
@ROAD_OPTION
@VOID_OPTION
@click.option("--conditions", type=PATH, help="CSV of each image's conditions. [that of ROOT]")
@click.option(
    "--leave-out",
    "left_out",
    multiple=True,
    metavar="GROUP",
    help="Exclude this group from means and chosen thresholds; score it apart; may be repeated.",
)
@click.option("--mean-from", help="Estimate prior:mean on another data set: NAME:ROOT.")
@click.option("--threshold-from", type=PATH, help="Take thresholds from an earlier metrics.json.")
@click.option("--limit", type=click.IntRange(min=1), help="Evaluate at most this many images.")
@JOBS_OPTION
@RUNTIME_OPTION
@click.option("--out", type=PATH, help="Folder for metrics.json, report.html and tables.")
@click.option(
    "--montage",
    type=click.IntRange(min=0),
    default=4,
    help="Show the N best, median and worst images of each detector.",
)
@click.pass_context
def evaluate_command(
    context: click.Context,
    dataset: str,
    root: Path,
    split: str | None,
    names: tuple[str, ...],
    assignments: tuple[str, ...],
    camera_file: Path | None,
    against: str | None,
    tune: bool,
    submit: bool,
    bev: bool,
    road: tuple[str, ...],
    void: tuple[str, ...],
    conditions: Path | None,
    left_out: tuple[str, ...],
    mean_from: str | None,
    threshold_from: Path | None,
    limit: int | None,
    jobs: int | None,
    runtime: str,
    out: Path | None,
    montage: int,
) -> None:
    """Score detectors on the labelled images of DATASET (camvid, kitti-road, …) at ROOT.

    Every image is read once and given to every detector. Blind baselines, which ignore the
    image, are scored as well: prior:rows, prior:triangle and, with several groups, prior:mean.

    --tune chooses the threshold with the highest F-score, averaged over the groups, for infer
    --config. It also prints the leave-one-group-out scores: F and IoU of each group at the
    threshold chosen on the other groups. --submit writes maps for KITTI's server, of the images
    in ROOT/image_2 or ROOT/testing/image_2.
    """
    from roadtorch.base.atomic import claim_results, lock_folder, relative_name
    from roadtorch.base.settings import parse_assignments
    from roadtorch.camera.camera import Camera
    from roadtorch.data.catalogue import open_dataset, open_dataset_spec
    from roadtorch.data.dataset import leave_out
    from roadtorch.data.kitti_road import use_birds_eye_view
    from roadtorch.data.label_folders import add_conditions
    from roadtorch.evaluation.evaluate import evaluate
    from roadtorch.evaluation.methods import compute_with, parse_contenders, parse_reference
    from roadtorch.evaluation.report.tables import SCREEN_WIDTH, format_tables
    from roadtorch.evaluation.tuning import choice_table, tune_thresholds, tuned_file
    from roadtorch.run.workers import configure_threads

    configure_threads()
    settings = parse_assignments(assignments)
    camera = None if camera_file is None else Camera.read(camera_file)
    if submit:
        assert out is not None
        if len(names) != 1 or dataset != "kitti-road":
            raise click.UsageError("--submit is for kitti-road and one --detector")
        contender = compute_with(parse_reference(names[0], settings, camera), runtime)
        write_submission(context, contender, root, out, jobs)
    if out is not None:
        origin = f"{dataset} {split or ''} {relative_name(root, out)}"
        named = (parse_contenders(name, settings, camera) for name in names if tune)
        files = (*REPORT_FILES, *(tuned_file(entry) for entries in named for entry in entries))
        context.with_resource(lock_folder(out))  # fail before the long run
        context.with_resource(claim_results(out, dict.fromkeys(files, origin)))
    labelled = leave_out(open_dataset(dataset, root, split, road=road, void=void), left_out)
    for line in labelled.summary.splitlines():
        click.echo(f"roadtorch: {line}", err=True)
    if conditions is not None:
        labelled = add_conditions(labelled, conditions)
    evaluation = evaluate(
        use_birds_eye_view(labelled) if bev else labelled,
        names,
        settings=settings,
        camera=camera,
        limit=limit,
        mean_from=None if mean_from is None else open_dataset_spec(mean_from),
        threshold_from=threshold_from,
        against=against,
        jobs=jobs,
        runtime=runtime,
        quiet=False,
    )
    click.echo(format_tables(evaluation))
    choices = tune_thresholds(evaluation) if tune else []
    if choices:
        click.echo(f"\n{choice_table(choices).text(SCREEN_WIDTH)}")
    if out is None:
        click.echo("\nMore columns, charts and images: report.html, written with --out DIR")
    print_cautions(evaluation)
    if out is not None:
        write_files(evaluation, choices, out, command_line(context), montage)
        click.echo(f"\nAll columns, charts and images: {out / 'report.html'}")
    context.exit(1 if evaluation.failures else 0)


def print_cautions(evaluation: "Evaluation") -> None:
    """Print a line for each detector trained on corrections, and for each kind of failure."""
    from roadtorch.layout.weights import count_corrected_images

    for name, figures in evaluation.detectors.items():
        if count := count_corrected_images(figures.contender.settings):
            text = f"{name} was trained on {count} images corrected by hand: it is not label-free, "
            click.echo(f"roadtorch: {text}and scores on those images are optimistic", err=True)
    failures: dict[str, list[Failure]] = {}
    for failure in evaluation.failures:  # of one kind where the text after the name is the same
        problem = failure.reason.rpartition(PurePath(failure.image).name)[2]
        failures.setdefault(problem, []).append(failure)
    for first, *more in failures.values():
        count = f"{len(more) + 1} images, the first " if more else ""
        click.echo(f"failed: {count}{first.image}: {first.reason}", err=True)


def write_files(
    evaluation: "Evaluation",
    choices: "Sequence[ThresholdChoice]",
    out: Path,
    command: str,
    montage: int,
) -> None:
    """Write metrics, tables and report, and a config for each chosen threshold."""
    from roadtorch.base.atomic import write_text
    from roadtorch.base.settings import to_toml
    from roadtorch.evaluation.report.files import write_report  # slow: it imports matplotlib
    from roadtorch.evaluation.tuning import provenance, tuned_file

    write_report(evaluation, out, command, montage)
    for choice in choices:
        comment = provenance(choice, evaluation, command)
        config = to_toml(choice.contender.detector, choice.settings)
        write_text(out / tuned_file(choice.contender), f"{comment}\n{config}\n")


def write_submission(
    context: click.Context, contender: "Contender", root: Path, out: Path, jobs: int | None
) -> None:
    """Write the maps of one detector for KITTI's server, and end the command.

    ROOT holds image_2 and calib, or testing/image_2 and testing/calib. The image um_000012
    gives um_road_000012.png, its likelihood in bird's-eye view (800 by 400, 8 bits), and all of
    them submission.zip once every image is done. Another run resumes.
    """
    from roadtorch.base.settings import to_toml
    from roadtorch.data.kitti_road import find_calibration_folder, find_kitti_folder
    from roadtorch.evaluation.methods import load_contender
    from roadtorch.inputs.find import Inputs
    from roadtorch.run.loop import Inference, Task
    from roadtorch.run.memo import cache_key
    from roadtorch.run.plan import RunOptions, plan_run
    from roadtorch.run.run import open_run
    from roadtorch.run.writers.kitti import (
        SUBMISSION_FILE,
        BirdsEyeWriter,
        find_submission_images,
        pack_submission,
    )

    detector = load_contender(contender)
    base = find_kitti_folder(root, "testing")
    maps = BirdsEyeWriter(out, find_calibration_folder(base))
    images = find_submission_images(base / "image_2", maps.calib, out)
    todo = plan_run(Inputs(images, []), out, maps.suffixes, files=[SUBMISSION_FILE])
    effective = to_toml(detector.name, detector.settings)
    run = context.with_resource(open_run(out, effective, todo, RunOptions(jobs)))
    task = Task(Inference(detector), maps, cache_key(detector), ("map",))
    if failed := run.process_images(images, task):
        click.echo(f"roadtorch: {out / SUBMISSION_FILE} not written: maps are missing", err=True)
        context.exit(failed)
    archive = pack_submission(images, out)
    click.echo(f"roadtorch: {len(images)} maps in {archive}", err=True)
    context.exit(0)
