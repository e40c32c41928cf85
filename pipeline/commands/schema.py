"""`drupe schema`."""

import json

import typer

from pipeline.safe_start import elsewhere


def schema() -> None:
    """Print the JSON schema of batch.toml, for editors that check TOML while it is written.

    Limits and types are the reader's own; what depends on several keys at once `drupe check` says.
    Example: drupe schema > batch.schema.json
    """
    with elsewhere():
        from pipeline.batch.settings import settings_schema
    typer.echo(json.dumps(settings_schema(), indent=1, ensure_ascii=False))
