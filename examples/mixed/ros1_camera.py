"""A camera of ROS 1 with rospy, run by Debian's own Python. It knows nothing of uoarm."""

# mypy: ignore-errors
# Of another Python than the rest.

import rospy
from sensor_msgs.msg import Image

WIDTH, HEIGHT, DARK = 64, 48, 20


def main() -> None:
    """Publish on /camera/image until interrupted."""
    rospy.init_node("camera", disable_signals=True)
    publisher = rospy.Publisher("/camera/image", Image, queue_size=10)
    data = bytes([DARK]) * (WIDTH * HEIGHT)
    while True:
        image = Image(height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH, data=data)
        image.header.stamp = rospy.Time.now()
        publisher.publish(image)
        rospy.sleep(0.05)


if __name__ == "__main__":
    main()
