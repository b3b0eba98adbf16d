"""Random messages of ROS 1 as genpy has them; run by the Python that has rospy.

    python3 genpy_messages.py SEED COUNT TYPE ...

writes for each type a line with its sum and definition, then COUNT lines with octets and values.
"""

import base64
import io
import json
import random
import sys

import genpy
import roslib.message

NUMBERS = {
    "int8": (-(2**7), 2**7 - 1),
    "byte": (-(2**7), 2**7 - 1),
    "uint8": (0, 2**8 - 1),
    "char": (0, 2**8 - 1),
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "int64": (-(2**63), 2**63 - 1),
    "uint64": (0, 2**64 - 1),
}
FLOATS = [
    0.0,
    -0.0,
    1.5,
    -2.25,
    5e-324,
    1.7976931348623157e308,
    float("inf"),
    float("-inf"),
    float("nan"),
]
DEFINED = {}
TEXTS = ["", "a", "Kia ora \u2192 \U0001f916", "\0", "x" * 300]


def fill(message, random_):
    for name, kind in zip(message.__slots__, message._slot_types):
        setattr(message, name, value(kind, random_))
    return message


def value(kind, random_):
    if kind.endswith("]"):
        element, _, size = kind[:-1].rpartition("[")
        count = int(size) if size else random_.choice([0, 1, 2, 7])
        items = [value(element, random_) for _ in range(count)]
        return bytes(items) if element in ("uint8", "char") else items
    if kind in NUMBERS:
        least, most = NUMBERS[kind]
        return random_.choice([least, most, 0, random_.randint(least, most)])
    if kind == "bool":
        return random_.choice([True, False])
    if kind == "float64":
        return random_.choice([*FLOATS, random_.uniform(-1e9, 1e9)])
    if kind == "float32":
        return random_.choice(
            [
                0.0,
                -0.5,
                1.25,
                float("inf"),
                float("nan"),
                2.0**-149,
                float(random_.randint(-9999, 9999)),
            ]
        )
    if kind == "string":
        return random_.choice(TEXTS)
    if kind == "time":
        return genpy.Time(random_.randint(0, 2**32 - 1), random_.randint(0, 10**9 - 1))
    if kind == "duration":
        return genpy.Duration(random_.randint(-(2**31), 2**31 - 1), random_.randint(0, 10**9 - 1))
    return fill((DEFINED.get(kind) or roslib.message.get_message_class(kind))(), random_)


def plain(message):
    if isinstance(message, (genpy.Time, genpy.Duration)):
        return {"secs": message.secs, "nsecs": message.nsecs}
    if isinstance(message, genpy.Message):
        return {name: plain(getattr(message, name)) for name in message.__slots__}
    if isinstance(message, bytes):
        return list(message)
    if isinstance(message, (list, tuple)):
        return [plain(item) for item in message]
    return message


def main():
    random_ = random.Random(int(sys.argv[1]))
    for name in sys.argv[3:]:
        kind = roslib.message.get_message_class(name)
        print(json.dumps({"type": name, "md5": kind._md5sum, "definition": kind._full_text}))
        for _ in range(int(sys.argv[2])):
            message = fill(kind(), random_)
            buffer = io.BytesIO()
            message.serialize(buffer)
            octets = base64.b64encode(buffer.getvalue()).decode()
            print(json.dumps({"octets": octets, "value": plain(message)}))


if __name__ == "__main__":
    main()
