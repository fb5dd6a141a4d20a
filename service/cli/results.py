"""Write the files of a result whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from service.errors import InvalidInput

UNFINISHED = ".unfinished"  # folder of the files that are being written


@contextmanager
def written_together(directory: Path, names: Sequence[str], *, force: bool = False) -> Iterator[Path]:
    """Yield a folder to write the named files into; at the end all move into `directory`, on an error none.

    The last name is the one whose presence says that the results are complete. Raises InvalidInput when the
    directory holds anything else and `force` is not set.
    """
    _refuse_other_things(directory, names, force=force)
    directory.mkdir(parents=True, exist_ok=True)
    folder = directory / UNFINISHED
    shutil.rmtree(folder, ignore_errors=True)  # of a run that was killed
    folder.mkdir()
    try:
        yield folder
        (directory / names[-1]).unlink(missing_ok=True)
        for name in names:
            (folder / name).replace(directory / name)
    finally:
        shutil.rmtree(folder)


def _refuse_other_things(directory: Path, names: Sequence[str], *, force: bool) -> None:
    if not directory.exists():
        return
    if not directory.is_dir():
        raise InvalidInput(f"{directory} is a file; --out wants a folder")
    others = sorted(path.name for path in directory.iterdir() if path.name not in {*names, UNFINISHED})
    if others and not force:
        raise InvalidInput(
            f"{directory} holds other things ({others[0]}, ...); name another folder or add --force"
        )
