"""`drupe schema`."""

import json

import typer

from pipeline.safe_start import elsewhere


def schema() -> None:
    """Print the JSON schema of batch.toml, for editors that check TOML files.

    The schema holds the limits and types of each key. `drupe check` also tests rules that combine several
    keys.

    Exit status: 0 printed; 1 internal error; 2 usage; 130 interrupted.

    Example: drupe schema > batch.schema.json
    """
    with elsewhere():
        from pipeline.batch.settings import settings_schema
    typer.echo(json.dumps(settings_schema(), indent=1, ensure_ascii=False))
