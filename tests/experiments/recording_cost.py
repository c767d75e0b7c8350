"""What recording two sensors costs: ``python -m tests.experiments.recording_cost [FOLDER]``.

Two threads give simulated depth and infrared images, 640 × 576 at 30 fps, to the recorders of ``duplex
record`` for ten seconds. The images were rendered before, so processor time is that of recording.
"""

import sys
import tempfile
import threading
import time
from itertools import islice
from pathlib import Path

from devices.sensor import SensorFrame
from devices.simulated.kinect import simulated_pair
from viewer_app.sinks.raw_recording import RawRecorder

_SECONDS, _FPS, _RENDERED = 10, 30, 30


def play(images, recorder):
    """Gives the images to a recorder, each when it is due."""
    begun = time.perf_counter()
    for number in range(_SECONDS * _FPS):
        time.sleep(max(0.0, begun + number / _FPS - time.perf_counter()))
        depth, ir = images[number % len(images)]
        time_ns = number * 1_000_000_000 // _FPS
        recorder.add(SensorFrame(time_ns, depth=depth, ir=ir, host_ns=time.perf_counter_ns()))


def main():
    sensors = simulated_pair(motion="walk", depth="full", infrared=True, seconds=4.0)[:2]
    rendered = [[(f.depth, f.ir) for f in islice(sensor.frames(), _RENDERED)] for sensor in sensors]
    for compress in (False, True):
        with tempfile.TemporaryDirectory(dir=sys.argv[1] if sys.argv[1:] else None) as folder:
            recorders = [
                RawRecorder(Path(folder) / f"{side}.mkv", sensor, compress=compress)
                for side, sensor in zip("ab", sensors, strict=True)
            ]
            cpu, begun = time.process_time(), time.perf_counter()
            both = zip(rendered, recorders, strict=True)
            threads = [threading.Thread(target=play, args=each) for each in both]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            for recorder in recorders:
                recorder.close()
            share = (time.process_time() - cpu) / (time.perf_counter() - begun)
            size = sum(recorder.written_bytes for recorder in recorders) / 2e6 / _SECONDS
            lost = sum(recorder.lost + recorder.without_images for recorder in recorders)
            kind = "--compress" if compress else "raw"
            print(f"{kind}: {size:.1f} MB/s each, {share:.0%} of a core, lost {lost}")


if __name__ == "__main__":
    main()
