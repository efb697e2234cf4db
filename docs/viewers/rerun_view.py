"""Opens a run in Rerun with the map from above, the camera, depth in colour, and the robot's own sentences.

    firmware-host buffer export RUN --as viewer --out run.mcap
    pip install rerun-sdk==0.36.3
    python docs/viewers/rerun_view.py run.mcap
    python docs/viewers/rerun_view.py run.mcap --screenshot run.png     # without a window
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.experimental import ViewerClient

TIMELINE = "message_log_time"


def from_the_beginning():
    """Shows all messages up to the present one, not only the newest."""
    return rrb.VisibleTimeRanges(
        timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )


def map_view(center_m, height_m):
    x_m, y_m = center_m
    return rrb.Spatial3DView(
        name="map from above",
        origin="/",
        contents=[
            "/map/voxels",
            "/scan/points",
            "/track/points",
            "/path/points",
            "/goal/points",
            "/robot/points",
            "/tf",
        ],
        background=[222, 226, 230],
        line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, color=[150, 158, 168, 120], stroke_width=1.0),
        spatial_information=rrb.SpatialInformation("map", show_axes=False),
        eye_controls=rrb.EyeControls3D(
            position=(x_m, y_m - 0.01, height_m), look_target=(x_m, y_m, 0), eye_up=(0, 1, 0)
        ),
        overrides={
            "/track/points": [from_the_beginning(), rr.Points3D.from_fields(radii=0.02)],
            "/path/points": rr.Points3D.from_fields(radii=0.025),
            "/scan/points": rr.Points3D.from_fields(radii=0.03),
            "/goal/points": rr.Points3D.from_fields(radii=0.12),
            "/robot/points": rr.Points3D.from_fields(radii=0.03),
        },
    )


def blueprint(center_m, height_m, play_state):
    images = rrb.Vertical(
        rrb.Spatial2DView(name="camera", origin="/camera/image"),
        rrb.Spatial2DView(name="depth: near yellow, far violet, grey none", origin="/depth/color"),
        rrb.TextLogView(name="what the robot does, and why", origin="/events"),
        row_shares=[1, 1, 1.4],
    )
    return rrb.Blueprint(
        rrb.Horizontal(map_view(center_m, height_m), images, column_shares=[1.35, 1]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state=play_state),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="a file of `buffer export --as viewer`")
    parser.add_argument("--height", type=float, default=16.0, help="of the eye above the map, metres")
    parser.add_argument(
        "--center", type=float, nargs=2, default=[0.0, 0.0], metavar=("X", "Y"), help="in `map`, metres"
    )
    parser.add_argument("--save", type=Path, metavar="VIEW.rbl", help="only write the blueprint")
    parser.add_argument("--screenshot", type=Path, metavar="PNG", help="draw without a window, and end")
    parser.add_argument("--size", default="1280x720", metavar="WxH", help="of the screenshot")
    parser.add_argument(
        "--wait", type=float, default=15.0, metavar="S", help="for the file to load before the screenshot"
    )
    parser.add_argument("--port", type=int, default=9877, help="of the viewer that draws the screenshot")
    arguments = parser.parse_args()
    # Rerun names what is in an MCAP file after the file, and applies the blueprints of that name.
    name = arguments.run.stem
    # A screenshot shows the end of the run.
    play_state = "following" if arguments.screenshot else "playing"
    view_of_run = blueprint(arguments.center, arguments.height, play_state)
    if arguments.save:
        view_of_run.save(name, str(arguments.save))
        return
    with tempfile.TemporaryDirectory() as folder:
        view = Path(folder) / "view.rbl"
        view_of_run.save(name, str(view))
        command = ["rerun", str(arguments.run), str(view), "--bind", "127.0.0.1"]
        if arguments.screenshot:
            draw(command, arguments)
        else:
            subprocess.run(command, check=True)


def draw(command, arguments):
    """Lets a viewer without a window load the file, and then save its image."""
    # Rerun shows its log over the image.
    environment = {**os.environ, "RUST_LOG": "off"}
    size = ["--headless", "--window-size", arguments.size, "--port", str(arguments.port)]
    # The command `rerun` starts the viewer as a process of its own, which has to end as well.
    viewer = subprocess.Popen([*command, *size], env=environment, start_new_session=True)
    try:
        # Rerun does not say when it has loaded a file.
        time.sleep(arguments.wait)
        file = arguments.screenshot.absolute()
        file.unlink(missing_ok=True)
        ViewerClient.connect(f"rerun+http://127.0.0.1:{arguments.port}/proxy").save_screenshot(str(file))
        time.sleep(2)
        if not file.exists():
            sys.exit(
                f"Rerun wrote no {file}; it needs Vulkan, also without a graphics card (Debian: mesa-vulkan-drivers)"
            )
    finally:
        os.killpg(viewer.pid, signal.SIGTERM)
        viewer.wait()


if __name__ == "__main__":
    main()
