"""A process of its own that runs the command on hostile files and notes what it is made to do."""

import contextlib
import io
import json
import os
import sys
from pathlib import Path

# What a recording has no business to cause. Python tells a hook of each before it happens.
FORBIDDEN = {
    "os.exec", "os.fork", "os.forkpty", "os.link", "os.posix_spawn", "os.remove", "os.rename",
    "os.symlink", "os.system", "os.truncate", "pickle.find_class", "pty.spawn", "shutil.rmtree",
    "socket.connect", "subprocess.Popen", "webbrowser.open", "ctypes.dlopen",
}  # fmt: skip


def run_all(folder: Path) -> list[tuple[str, object, str, list[str]]]:
    """For every recording in `folder`: its name, the exit code, what was said, what was caused."""
    from srsinv.__main__ import main

    caused: list[str] = []
    watching = False

    def hook(event: str, arguments: tuple) -> None:
        # A run prepares its own folder, and clears it away again.
        if not watching or (arguments and "/outputs" in str(arguments[0])):
            return
        is_written = event == "open" and isinstance(arguments[1], str) and arguments[1][:1] in "wax"
        if event in FORBIDDEN or is_written:
            caused.append(f"{event} {arguments[:1]!r}")

    # What imports cause is not looked at, nor the process that reads HDF5.
    with contextlib.redirect_stderr(io.StringIO()):
        for job, files in (("inspect_recording", "yaml*.csv"), ("invert_recording", "netcdf*.nc")):
            main([f"experiment={job}", f"recording.path={next(folder.glob(files))}"])
    sys.addaudithook(hook)
    reports = []
    for path in sorted([*folder.glob("*.csv"), *folder.glob("*.nc")]):
        job = "inspect_recording" if path.name.startswith("yaml") else "invert_recording"
        said = io.StringIO()
        caused.clear()
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            watching = True
            code = main([f"experiment={job}", f"recording.path={path}"])
            watching = False
        reports.append((path.stem, code, said.getvalue(), list(caused)))
    return reports


if __name__ == "__main__":
    os.chdir(sys.argv[1])
    print(json.dumps(run_all(Path("."))))
