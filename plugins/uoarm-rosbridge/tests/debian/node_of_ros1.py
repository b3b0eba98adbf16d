"""A node of ROS 1 behind a rosbridge server; run by the Python that has rospy.

Topics, one of them latched, an echo, a service, a parameter, and actions of actionlib.
"""

# mypy: ignore-errors
# Of Debian's own Python, which knows nothing of this repository.

import sys
import time

import actionlib
import rospy
from actionlib.msg import TwoIntsAction, TwoIntsResult
from sensor_msgs.msg import Image, LaserScan, NavSatFix
from std_msgs.msg import String
from std_srvs.srv import SetBool

WIDTH, HEIGHT = 64, 48


def main():
    """Run until the process is ended."""
    rospy.init_node("behind")
    rospy.set_param("/behind/speed", 7)
    picture = Image(width=WIDTH, height=HEIGHT, encoding="mono8", step=WIDTH)
    picture.header.stamp.secs = 5
    picture.data = bytes(index % 256 for index in range(WIDTH * HEIGHT))
    scan = LaserScan(ranges=[0.5, float("inf"), float("nan")], range_max=2.5)
    pictures = rospy.Publisher("/behind/picture", Image, queue_size=10)
    scans = rospy.Publisher("/behind/scan", LaserScan, queue_size=10)
    fixes = rospy.Publisher("/behind/fix", NavSatFix, queue_size=10)
    kept = rospy.Publisher("/behind/map", String, queue_size=1, latch=True)
    kept.publish("a map")
    echo = rospy.Publisher("/behind/echoed", String, queue_size=1000)
    rospy.Subscriber("/behind/asked", String, echo.publish, queue_size=1000)
    rospy.Service("/behind/set", SetBool, lambda ask: (ask.data, "data is %s" % ask.data))
    add = actionlib.SimpleActionServer("/behind/add", TwoIntsAction, auto_start=False)
    add.register_goal_callback(lambda: end(add))
    add.start()
    hold = actionlib.SimpleActionServer("/behind/hold", TwoIntsAction, auto_start=False)
    hold.register_goal_callback(hold.accept_new_goal)
    hold.register_preempt_callback(lambda: hold.set_preempted(TwoIntsResult(sum=-1), "let go"))
    hold.start()
    print("ready", flush=True)
    while not rospy.is_shutdown():
        pictures.publish(picture)
        scans.publish(scan)
        fixes.publish(NavSatFix(position_covariance=[float(place) for place in range(9)]))
        time.sleep(0.05)


def end(server):
    goal = server.accept_new_goal()
    if goal.a < 0:
        server.set_aborted(TwoIntsResult(), "it cannot")
    else:
        server.set_succeeded(TwoIntsResult(sum=goal.a + goal.b))


if __name__ == "__main__":
    sys.exit(main())
