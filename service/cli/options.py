"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]
ShowProgress = Annotated[
    bool | None, typer.Option("--progress/--no-progress", help="Show progress. [default: on a terminal]")
]
Filter = Annotated[
    str | None, typer.Option("--filter", metavar="NAME", help="Filter of each track, such as astekf or imm.")
]
Profile = Annotated[
    str | None,
    typer.Option("--profile", metavar="NAME", help="Cost and accuracy: fast, default or quality."),
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One parameter of the tracker; repeat for more."),
]
Site = Annotated[Path, typer.Option("--site", metavar="SITE.json", help="The sensor as mounted.")]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results; made when missing.")]
Force = Annotated[bool, typer.Option("--force", help="Write into a folder that holds other things too.")]
DataDir = Annotated[
    Path | None, typer.Option("--data-dir", metavar="DIR", help="Log and database. [WAYSIDE_DATA_DIR, data]")
]
Database = Annotated[
    str | None,
    typer.Option(
        "--database", metavar="URL", help="sqlite:///PATH or postgresql://... [WAYSIDE_DATABASE_URL]"
    ),
]
Port = Annotated[
    int | None, typer.Option("--port", min=0, max=65535, help="0: any free one. [WAYSIDE_PORT, 8321]")
]
Url = Annotated[str, typer.Option("--url", envvar="WAYSIDE_URL", help="Address of the service.")]
Key = Annotated[str | None, typer.Option("--key", envvar="WAYSIDE_KEY", help="API key.", show_envvar=True)]

DEFAULT_URL = "http://127.0.0.1:8321"
