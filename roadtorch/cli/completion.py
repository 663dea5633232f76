"""roadtorch completion: what a shell needs to complete commands, names and settings."""

import os

import click
from click.shell_completion import (
    BashComplete,
    CompletionItem,
    add_completion_class,
    get_completion_class,
    split_arg_string,
)

VARIABLE = "_ROADTORCH_COMPLETE"
"""Of the environment: the shell asks for what could come next. click's name for it."""

SHELLS = ("bash", "fish", "zsh")


@add_completion_class
class Bash(BashComplete):
    """Bash breaks words at ``:`` and ``=``, where our names and settings have them.

    So it hands over the line as far as the cursor, and gets back what goes behind the break.
    """

    source_template = """\
%(complete_func)s() {
    local IFS=$'\\n' type value response
    response=$(env COMP_LINE="${COMP_LINE:0:$COMP_POINT}" COMP_WORDBREAKS="$COMP_WORDBREAKS" \\
        %(complete_var)s=bash_complete "$1")
    COMPREPLY=()
    for completion in $response; do
        IFS=',' read -r type value <<< "$completion"
        case $type in
            dir) compopt -o dirnames ;;
            file) compopt -o default ;;
            plain)
                COMPREPLY+=("$value")
                [[ $value == *[=:] ]] && compopt -o nospace ;;
        esac
    done
    return 0
}
complete -o nosort -F %(complete_func)s %(prog_name)s
"""

    def get_completion_args(self) -> tuple[list[str], str]:
        """The words before the one at the cursor, and that one as far as it is there."""
        line = os.environ["COMP_LINE"]
        words = split_arg_string(line)[1:]
        if not words or line[-1:].isspace():
            return words, ""
        return words[:-1], words[-1]

    def format_completion(self, item: CompletionItem) -> str:
        """Type and value, less what stands before the last break of the word."""
        breaks = set(os.environ.get("COMP_WORDBREAKS", "")) & set(":=")
        word = self.get_completion_args()[1]
        kept = max((word.rfind(letter) for letter in breaks), default=-1) + 1
        value = item.value if item.type != "plain" else item.value[kept:]
        return f"{item.type},{value}"


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print what makes SHELL complete commands, options, detectors, settings and data sets.

    \b
    bash  echo 'eval "$(roadtorch completion bash)"' >> ~/.bashrc
    zsh   echo 'eval "$(roadtorch completion zsh)"' >> ~/.zshrc
    fish  roadtorch completion fish > ~/.config/fish/completions/roadtorch.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "roadtorch", VARIABLE).source())
