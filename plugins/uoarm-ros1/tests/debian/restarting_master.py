"""A ROS master that is started and stopped again and again in one process.

    python3 restarting_master.py PORT

Each line, `start` or `stop`, is answered by itself once it is done.
"""

# Of Debian's own Python, which knows nothing of this repository.
# mypy: ignore-errors

import sys

from rosmaster.master import Master

master = None
for line in sys.stdin:
    if line.strip() == "start":
        master = Master(int(sys.argv[1]))
        master.start()
    else:
        # What rospy's own stop leaves open: a dead process has no socket.
        master.master_node.server.socket.close()
        master.stop()
    print(line.strip(), flush=True)
