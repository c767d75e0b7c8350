"""``duplex live`` on stand-ins for two Kinects."""

from tests.helpers.command_line import duplex


class Live:
    """Records sessions without a viewer into the file `saved`."""

    def __init__(self, standin, saved, capsys):
        self.saved = saved
        self._standin, self._capsys = standin, capsys

    def __call__(self, *more, seconds=1.0, codes=(0,)):
        """Runs a session and checks its exit code; returns the words that it printed."""
        self._capsys.readouterr()
        ended = duplex(
            *("live", "--kinect-a", "000123", "--kinect-b", "000456", "--k4abt", self._standin.path),
            *("--no-viewer", "--save", self.saved, "--seconds", seconds, *more),
        )
        printed = self._capsys.readouterr()
        assert ended in codes, printed
        return printed.err if ended else " ".join(printed.out.split())
