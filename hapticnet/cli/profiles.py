"""The profile that a command of ``hapticnet device`` writes."""

from pathlib import Path


def profile_to_write(profile: Path | None, out: Path | None) -> Path | None:
    """Return the file to which a command writes the profile: `out`, else `profile`, else none.

    Raises SettingsError if the file exists and is not `profile`, so that earlier results would be lost; FileError if it
    cannot be written.
    """
    from hapticnet.cli.console import check_outputs
    from hapticnet.errors import SettingsError

    file = out or profile
    if file is not None and file != profile and file.exists():
        raise SettingsError(f"{file} exists; update it with --profile {file} or choose another file with --out FILE")
    check_outputs(file)
    return file
