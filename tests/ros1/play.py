"""Plain rospy nodes that play robot: python -m tests.ros1.play WHAT ...; they know nothing of LinkRover's nodes."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import rospy

from linkrover.ros1.fill import plain
from linkrover.ros1.types import message_class


def camera(rate_hz: str, width: str, height: str) -> None:
    """640x480 rgb8 as a camera driver sends it."""
    image = message_class("sensor_msgs/Image")
    publisher = rospy.Publisher("camera/image", image, queue_size=2)
    message = image(width=int(width), height=int(height), encoding="rgb8", step=3 * int(width))
    message.data = bytes(3 * int(width) * int(height))
    _at(rate_hz, lambda _: publisher.publish(message))


def laser(rate_hz: str) -> None:
    """A scan of 720 beams."""
    scan = message_class("sensor_msgs/LaserScan")
    publisher = rospy.Publisher("scan", scan, queue_size=5)
    message = scan(angle_min=-2.36, angle_max=2.36, angle_increment=4.72 / 720, range_max=30.0)
    message.ranges = [5.0] * 720
    _at(rate_hz, lambda _: publisher.publish(message))


def odometry(rate_hz: str, speed_m_per_s: str = "0.5") -> None:
    """A circle of 2 m radius."""
    odom = message_class("nav_msgs/Odometry")
    publisher = rospy.Publisher("odom", odom, queue_size=5)
    message = odom()
    message.header.frame_id = "odom"

    def publish(t_s: float) -> None:
        angle = t_s * float(speed_m_per_s) / 2.0
        message.header.stamp = rospy.Time.now()
        message.pose.pose.position.x = 2 * math.cos(angle)
        message.pose.pose.position.y = 2 * math.sin(angle)
        message.pose.pose.orientation.z = math.sin(angle / 2 + math.pi / 4)
        message.pose.pose.orientation.w = math.cos(angle / 2 + math.pi / 4)
        message.twist.twist.linear.x = float(speed_m_per_s)
        publisher.publish(message)

    _at(rate_hz, publish)


def odometry_from(file: str, rate_hz: str) -> None:
    """The pose that stands in a file."""
    odom = message_class("nav_msgs/Odometry")
    publisher = rospy.Publisher("odom", odom, queue_size=5)
    message = odom()
    message.header.frame_id = "odom"

    def publish(_: float) -> None:
        x_m, y_m, heading_rad = (float(word) for word in Path(file).read_text().split())
        message.header.stamp = rospy.Time.now()
        message.pose.pose.position.x, message.pose.pose.position.y = x_m, y_m
        message.pose.pose.orientation.z = math.sin(heading_rad / 2)
        message.pose.pose.orientation.w = math.cos(heading_rad / 2)
        publisher.publish(message)

    _at(rate_hz, publish)


def command(rate_hz: str) -> None:
    """Velocity commands of a teleoperator."""
    twist = message_class("geometry_msgs/Twist")
    publisher = rospy.Publisher("cmd_vel", twist, queue_size=5)
    message = twist()
    message.linear.x = 0.5
    _at(rate_hz, lambda _: publisher.publish(message))


def transforms(rate_hz: str) -> None:
    """map <- odom <- base_link."""
    text = "geometry_msgs/TransformStamped[] transforms\n"
    publisher = rospy.Publisher("/tf", tf_class(text), queue_size=5)
    stamped = message_class("geometry_msgs/TransformStamped")

    def publish(t_s: float) -> None:
        first, second = stamped(), stamped()
        first.header.frame_id, first.child_frame_id = "map", "odom"
        second.header.frame_id, second.child_frame_id = "odom", "base_link"
        first.transform.translation.x, first.transform.rotation.w = 10.0, 1.0
        second.transform.translation.x, second.transform.rotation.w = t_s, 1.0
        publisher.publish(publisher.data_class(transforms=[first, second]))

    _at(rate_hz, publish)


def tf_class(text: str) -> Any:
    from genpy.dynamic import generate_dynamic

    stamped = message_class("geometry_msgs/TransformStamped")
    separator = "=" * 80
    full = f"{text}{separator}\nMSG: geometry_msgs/TransformStamped\n{stamped._full_text}"
    return generate_dynamic("tf2_msgs/TFMessage", full)["tf2_msgs/TFMessage"]


def other_md5(topic: str, rate_hz: str) -> None:
    """A package of the same name whose message has another definition."""
    from genpy.dynamic import generate_dynamic

    name = "network_analysis/PingActionResult"
    publisher = rospy.Publisher(topic, generate_dynamic(name, "bool something_else\n")[name], queue_size=1)
    _at(rate_hz, lambda _: publisher.publish())


def listen(topic: str, type_name: str, count: str) -> None:
    """Print messages as JSON."""
    left = [int(count)]

    def take(message: Any) -> None:
        if left[0] > 0:
            print(json.dumps(plain(message), default=str), flush=True)
        left[0] -= 1
        if left[0] <= 0:
            rospy.signal_shutdown("enough")

    rospy.Subscriber(topic, message_class(type_name), take, queue_size=100)
    rospy.spin()


def swallow(topic: str, type_name: str) -> None:
    """Subscribe and do nothing."""
    rospy.Subscriber(topic, message_class(type_name), lambda _: None, queue_size=1, buff_size=1 << 22)
    rospy.spin()


def _at(rate_hz: str, work: Any) -> None:
    rate = rospy.Rate(float(rate_hz))
    began = rospy.get_time()
    while not rospy.is_shutdown():
        work(rospy.get_time() - began)
        try:
            rate.sleep()
        except rospy.ROSInterruptException:
            return


if __name__ == "__main__":
    what, *arguments = sys.argv[1:]
    rospy.init_node(f"play_{what}", anonymous=True)
    globals()[what](*arguments)
