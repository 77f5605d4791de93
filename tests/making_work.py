"""Work for the pool that takes no time, or ends badly; its functions are found by their names."""

import logging
import os
import signal
import time

from volatool.batch.identity import identify
from volatool.batch.work import Output, Result, Unit, digest_of
from volatool.errors import VolatoolError
from volatool.naming import stem
from volatool.outputs import OutputSet
from volatool.report import Report


def result_of(unit: Unit, **more) -> Result:
    report = Report(status="ok", input={"name": unit.path.name}, options=unit.options.given())
    return Result(unit.index, report, attempts=unit.attempt, **more)


def quick(unit, progress):
    progress(1, 2)
    progress(2, 2)
    return result_of(unit)


def say_pid(unit, progress):
    time.sleep(0.02)
    report = Report(status="ok", input={"pid": os.getpid()})
    return Result(unit.index, report)


def log(unit, progress):
    try:
        raise VolatoolError("told")
    except VolatoolError as error:
        logging.getLogger("volatool.making").warning("a line of %s", unit.path, exc_info=error)
    return result_of(unit)


def die_of_some(unit, progress):
    """Tiles named once die at their first attempt, those named twice at both."""
    name = unit.path.name
    if name.startswith("twice") or (name.startswith("once") and unit.attempt == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return result_of(unit)


def exit_at_once(unit, progress):
    os._exit(3)


def copy(unit, progress):
    """Write what is in the input as its report; inputs named bad fail."""
    if unit.path.name.startswith("bad"):
        return failed_of(unit)
    with OutputSet(unit.overwrite) as outputs:
        target = unit.outdir / (stem(unit.path) + ".stats.json")
        outputs.add(target).write_bytes(unit.path.read_bytes())
        paths = outputs.commit()
    digests = [digest_of(path) if unit.with_digests else None for path in paths]
    outputs = [
        Output(path, path.stat().st_size, digest)
        for path, digest in zip(paths, digests, strict=True)
    ]
    return result_of(unit, identity=identify(unit.path), outputs=tuple(outputs))


def failed_of(unit):
    error = {"code": "E_CORRUPT", "message": f"{unit.path}: is bad"}
    report = Report(status="failed", input={"name": unit.path.name}, error=error)
    return Result(unit.index, report, identity=identify(unit.path), attempts=unit.attempt)


def write_for_ever(unit, progress):
    """Begin to write an output and say where; never end."""
    with OutputSet(overwrite=True) as outputs:
        outputs.add(unit.outdir / f"{unit.path.name}.out").write_text("half")
        progress(os.getpid(), 1 << 40)
        while True:
            time.sleep(0.01)
