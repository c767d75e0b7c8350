"""Runs a generator in a process of its own, because libraries crash at damaged files, or never end."""

import faulthandler
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from fusion.errors import DuplexError

_CHILD = "from devices.recorded.apart import serve; serve()"
_ENDLESS, _FAULT = 1, 2  # exit codes; the first is faulthandler's
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}  # each reserves address space


class ApartError(DuplexError):
    """The other process did not get to its end. The message is a clause, as "it crashed"."""


def items_of(
    function: Callable[..., Iterator[Any]], *arguments: Any, seconds: float, memory: int
) -> Generator[Any, None, None]:
    """What a module's generator function yields, one by one; it goes on when the next one is asked for.

    Args:
        seconds: The most that it may take for each item.
        memory: The most bytes that it may use (Linux).

    Raises:
        DuplexError: What it raises.
        ApartError: It crashed, or took longer.
    """
    packages = os.pathsep.join(filter(None, (str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH"))))
    with subprocess.Popen(
        [sys.executable, "-P", "-c", _CHILD],
        env={**os.environ, **_ENVIRONMENT, "PYTHONPATH": packages},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        process_group=0,  # else Ctrl-C would end it while it starts
    ) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            pickle.dump((function.__module__, function.__name__, arguments, seconds, memory), child.stdin)
            child.stdin.flush()
            while True:
                item, fault = pickle.load(child.stdout)
                if fault is not None:
                    raise fault
                yield item
        except StopIteration:
            return
        except (OSError, EOFError, pickle.UnpicklingError):
            endless = child.wait() == _ENDLESS
            raise ApartError("it does not end" if endless else "it crashed, so the file is damaged") from None
        finally:
            child.kill()


def serve() -> None:
    """Runs the function that the standard input names, until that is closed."""
    module, name, arguments, seconds, memory = pickle.load(sys.stdin.buffer)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(os.fdopen(os.dup(0), "rb"),), daemon=True).start()
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # libraries that load would wait for the thread on Windows
    if sys.platform == "linux":  # macOS refuses
        import resource

        most = resource.getrlimit(resource.RLIMIT_AS)[1]
        memory = memory if most == resource.RLIM_INFINITY else min(memory, most)
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries print
    faulthandler.dump_traceback_later(seconds, exit=True)
    try:
        for item in getattr(import_module(module), name)(*arguments):
            faulthandler.cancel_dump_traceback_later()  # the reader takes its time
            pickle.dump((item, None), out, pickle.HIGHEST_PROTOCOL)
            out.flush()
            faulthandler.dump_traceback_later(seconds, exit=True)
        end: Exception = StopIteration()
    except MemoryError:
        end = ApartError("it does not fit into memory")
    except DuplexError as error:
        end = error
    except BaseException:
        os._exit(_FAULT)
    pickle.dump((None, end), out)
    out.flush()
    os._exit(0)  # libraries crash at a regular exit


def _end_with(stream: Any) -> None:
    """Ends the process when its parent is gone."""
    stream.read()
    os._exit(0)
