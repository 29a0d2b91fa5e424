"""The root command, and what all commands have in common. They import what they need when called: help is quick."""

from typing import Any

import click

from ..tools.cache import compile_cache

LOST = 1
"""Exit code where nothing finite came out."""
WRONG = 2
"""Exit code after an error."""
INTERRUPTED = 130
"""Exit code after Ctrl-C."""


class Command(click.Command):
    """A command that refuses an option which is given twice and can have one value only."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        _, _, given = self.make_parser(ctx).parse_args(list(args))
        for option in given:
            if given.count(option) > 1 and not getattr(option, "multiple", True):
                raise click.UsageError(f"Option {option.opts[0]} must be given once, but is given more often.")
        return super().parse_args(ctx, args)


class Group(click.Group):
    """A group of such commands, which an interrupt ends without a word of click's."""

    command_class = Command
    group_class = type

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            ctx.exit(INTERRUPTED)


def _print_versions(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from ..flow.datasets import versions

        of = dict(versions())
        print(f"slipperjax {of.pop('slipperjax')} ({', '.join(f'{name} {version}' for name, version in of.items())})")
        ctx.exit()


@click.group(cls=Group, context_settings={"show_default": True})
@click.option(
    "--cache/--no-cache",
    default=True,
    help="Keep compiled programs in the user's cache folder, or in that of SLIPPERJAX_CACHE.",
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_versions,
    help="Print versions and exit.",
)
def app(cache: bool) -> None:
    """Nonlinear dynamics of rocket-sled slippers."""
    if cache:
        compile_cache()
