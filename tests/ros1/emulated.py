"""Robot and station on one ROS graph over the emulated radio: python -m tests.ros1.emulated CASE SECONDS OUT.

One rosmaster on the robot, as in the paper; camera and laser scans to the station, velocity commands back, a node of
ours at each end, `rosbag record` on the robot. Everything ends in order; OUT/run is the run,
OUT/robot.bag the bag, OUT/log/ has what each program said.
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

from linkrover.bag import Recorder
from linkrover.emulator import presets
from linkrover.emulator.motion import Scripted
from linkrover.emulator.netns import become_namespace_root
from linkrover.emulator.robot import ROUTES
from linkrover.emulator.world import ADDRESSES, World, WorldSettings
from linkrover.experiment.trial import truth_manifest

ROOT = Path(__file__).resolve().parents[2]
PORT = 11311
IMAGE_HZ = 3.0
ANSWERED = "a ping server answers"
BAG_TOPICS = r"/robot/.*|/odom|/diagnostics"


class Ends:
    """Programs at both ends, ended by SIGINT in the reverse order."""

    def __init__(self, world: World, out: Path) -> None:
        self.world = world
        self.log = out / "log"
        self.log.mkdir(parents=True)
        self.running: list[tuple[str, subprocess.Popen[bytes]]] = []
        for name in [n for n in os.environ if n.startswith("ROS_")]:
            del os.environ[name]
        os.environ |= {
            "ROS_MASTER_URI": f"http://{ADDRESSES['robot']}:{PORT}",
            "ROS_HOME": str(out / "ros_home"),
            "PYTHONPATH": f"{ROOT}:{ROOT / 'src/linkrover/ros1/generated'}",
        }

    def start(self, end: str, title: str, *command: str) -> None:
        log = shlex.quote(str(self.log / f"{title}.log"))
        shell = f"export ROS_IP={ADDRESSES[end]}; exec {shlex.join(command)} > {log} 2>&1"
        self.running.append((title, self.world.popen(end, ["/bin/sh", "-c", shell])))

    def stop(self) -> None:
        for title, process in reversed(self.running):
            process.send_signal(signal.SIGINT)
            until = time.monotonic() + 30
            while process.poll() is None and time.monotonic() < until:
                self.world.run(0.05)
            if process.poll() is None:
                print(f"{title} had to be killed", flush=True)
                process.kill()
                process.wait()
        self.running.clear()


def main() -> None:
    case, seconds, out = sys.argv[1], float(sys.argv[2]), Path(sys.argv[3])
    trajectory = sys.argv[4] if len(sys.argv) > 4 else "still"
    out.mkdir(parents=True)
    setup = presets.find(case)
    settings = WorldSettings(case=setup, seed=1, route=ROUTES.get(trajectory, ROUTES["out-and-back"]), run=out.name)
    become_namespace_root()
    truth = Recorder(out / "run/truth", truth_manifest(settings, out.name), end="truth")
    python, play = sys.executable, [sys.executable, "-m", "tests.ros1.play"]
    with World(settings, out, truth.take) as world:
        world.start_link()
        motion = Scripted(
            settings.route, settings.drive, world.path("pose-robot"), still_m=3.0 if trajectory == "still" else None
        )
        pose_file = out / "pose.txt"
        beside = out / "pose.new"

        def drive() -> bool:
            motion.step()
            beside.write_text(f"{motion.robot.x_m} {motion.robot.y_m} {motion.robot.heading_rad}")
            beside.rename(pose_file)
            return False

        ends = Ends(world, out)
        ends.start("robot", "rosmaster", "rosmaster", "--core", "-p", str(PORT))
        world.run(1.0, drive, 0.05)
        ends.start("robot", "odometry", *play, "odometry_from", str(pose_file), "20")
        ends.start("robot", "camera", *play, "camera", str(IMAGE_HZ), "640", "480")
        ends.start("robot", "laser", *play, "laser", "10")
        ends.start("station", "images", *play, "swallow", "camera/image", "sensor_msgs/Image")
        ends.start("station", "scans", *play, "swallow", "scan", "sensor_msgs/LaserScan")
        ends.start("station", "commands", *play, "command", "10")
        ends.start("robot", "drives", *play, "swallow", "cmd_vel", "geometry_msgs/Twist")
        common = [python, "-m", "linkrover", "ros1"]
        measured = [
            "-i",
            "wlan0",
            "--record",
            str(out / "run"),
            "--emulated",
            "--case",
            setup.name,
            "--traffic-period",
            "1",
        ]
        ends.start("station", "server", *common, "server", *measured, "--wireless-path", world.path("station.wireless"))
        ends.start(
            "robot", "client", *common, "client", *measured, "--wireless-path", world.path("robot.wireless"),
            "--odom", "/odom", "--cmd-vel", "/cmd_vel",
        )  # fmt: skip
        client_log = ends.log / "client.log"
        world.run(40.0, lambda: drive() or (client_log.exists() and ANSWERED in client_log.read_text()), 0.05)
        bag = out / "robot.bag"
        ends.start("robot", "rosbag", "rosbag", "record", "-O", str(bag), "-e", BAG_TOPICS, "__name:=rosbag_record")
        world.run(30.0, lambda: drive() or any(out.glob("robot.bag*")), 0.05)
        world.run(seconds, drive, 0.05)
        extra = sys.argv[5:]
        if extra:
            ends.start("station", "extra", *extra)
            world.run(25.0, drive, 0.05)
        ends.stop()
    truth.close()


if __name__ == "__main__":
    main()
