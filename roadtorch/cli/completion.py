"""What a shell is told could come next where click does not know: detectors, data sets, files.

Each function is a ``shell_complete`` of click: what stands before and the word so far, to names.
"""

import click
from click.shell_completion import CompletionItem


def suggest_files(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Files and folders: the shell knows them."""
    return [CompletionItem(incomplete, type="file")]


def suggest_detectors(_: click.Context, __: click.Parameter, incomplete: str) -> list[str]:
    """Detectors; those of a grid of hundreds are left to ``roadtorch detectors``."""
    from roadtorch.detectors.catalogue import list_detectors

    return [name for name in list_detectors("*") if name.startswith(incomplete)]


def suggest_candidates(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[str] | list[CompletionItem]:
    """Detectors, or else weight files, configs and folders of maps."""
    detectors = suggest_detectors(context, parameter, incomplete)
    return detectors or suggest_files(context, parameter, incomplete)


def suggest_datasets(_: click.Context, __: click.Parameter, incomplete: str) -> list[str]:
    """Labelled sets."""
    from roadtorch.data.catalogue import list_datasets

    return [name for name in list_datasets() if name.startswith(incomplete)]
