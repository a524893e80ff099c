"""The other end of a Universal Robot's wires, in a process of its own, written from the maker's descriptions.

Port 29999 is the dashboard server, 30001 to 30003 take URScript, 30004 speaks RTDE ("Real-Time Data Exchange (RTDE)
Guide"): packages of a size, a type and a body, big-endian; recipes of named outputs that are sent at a rate, and of
named inputs. A script that was uploaded is not interpreted: it is taken for the control script of `ur-rtde`, which
takes a command from an integer input register, says 2 in an output register when it has done it, and 1 when it waits
for the next.

    python -m tests.drive.ur_controller ADDRESS

A request {"pose": [...]} moves the tool, {"stop": true} is a protective stop, {"cut": true} ends all connections; each
is answered with the commands that came since.
"""

from __future__ import annotations

import socket
import struct
import sys
import threading
import time
from contextlib import suppress
from typing import Any

from tests.drive.other_end import answer_lines

SERIAL, SOFTWARE = "20225500001", (5, 12, 2, 1101534)
RATE = 500.0
FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
TYPES = {
    "timestamp": "DOUBLE", "speed_scaling": "DOUBLE", "target_speed_fraction": "DOUBLE", "actual_momentum": "DOUBLE",
    "actual_main_voltage": "DOUBLE", "actual_robot_voltage": "DOUBLE", "actual_robot_current": "DOUBLE",
    "robot_status_bits": "UINT32", "safety_status_bits": "UINT32", "safety_status": "INT32", "runtime_state": "UINT32",
    "robot_mode": "INT32", "safety_mode": "INT32", "actual_execution_time": "DOUBLE", "payload": "DOUBLE",
    "actual_digital_input_bits": "UINT64", "actual_digital_output_bits": "UINT64", "joint_mode": "VECTOR6INT32",
    "tcp_force_scalar": "DOUBLE", "payload_cog": "VECTOR3D", "payload_inertia": "VECTOR6D", "tool_data": "DOUBLE",
    "actual_tool_accelerometer": "VECTOR3D", "elbow_position": "VECTOR3D", "elbow_velocity": "VECTOR3D",
    "speed_slider_mask": "UINT32", "speed_slider_fraction": "DOUBLE", "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8", "configurable_digital_output_mask": "UINT8", "tool_digital_output": "UINT8",
    "configurable_digital_output": "UINT8", "tool_digital_output_mask": "UINT8", "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8", "external_force_torque": "VECTOR6D", "ft_raw_wrench": "VECTOR6D",
}  # fmt: skip
PARTS = {"int_register": "INT32", "double_register": "DOUBLE", "bit_register": "BOOL", "analog": "DOUBLE"}
VECTORS = ("target_", "actual_", "joint_")  # beginnings of the names of six numbers
REALTIME = (6, 11, 24)  # commands that are taken again and again: force mode and servoing
WAITING, DONE = 1, 2  # as the script says it in its first integer register


def type_of(name: str) -> str:
    """The type of a variable, as the tables of the guide have it."""
    if name in TYPES:
        return TYPES[name]
    for part, kind in PARTS.items():
        if part in name:
            return kind
    return "VECTOR6D" if name.startswith(VECTORS) else "NOT_FOUND"


class Exchange:
    """One connection of RTDE: its recipes."""

    def __init__(self, controller: Controller, one: socket.socket) -> None:
        self.controller, self.one, self.lock = controller, one, threading.Lock()
        self.inputs: list[list[str]] = []
        self.outputs: list[str] = []
        self.rate, self.going = RATE, threading.Event()

    def send(self, kind: str, body: bytes) -> None:
        with self.lock:
            self.one.sendall(struct.pack(">HB", 3 + len(body), ord(kind)) + body)

    def answer(self, kind: str, body: bytes) -> bytes:
        if kind == "v":
            return struct.pack(">4I", *SOFTWARE)
        if kind == "O":
            self.rate = struct.unpack(">d", body[:8])[0]
            self.outputs = names_in(body[8:])
            return b"\x01" + types_of(self.outputs)
        if kind == "I":
            self.inputs.append(names_in(body))
            return bytes([len(self.inputs)]) + types_of(self.inputs[-1])
        (self.going.set if kind == "S" else self.going.clear)()
        return b"\x01"  # version, start, pause: accepted

    def inputs_in(self, body: bytes) -> dict[str, Any]:
        names = self.inputs[body[0] - 1]
        return dict(zip(names, struct.unpack(layout_of(names), body[1:]), strict=True))

    def states(self) -> None:
        following = time.monotonic()
        with suppress(OSError):
            while self.going.is_set():
                following += 1.0 / self.rate
                values = [value for name in self.outputs for value in self.controller.value(name)]
                self.send("U", b"\x01" + struct.pack(layout_of(self.outputs), *values))
                time.sleep(max(following - time.monotonic(), 0.0))


def names_in(body: bytes) -> list[str]:
    return [name for name in body.decode().split(",") if name]


def types_of(names: list[str]) -> bytes:
    return ",".join(map(type_of, names)).encode()


def layout_of(names: list[str]) -> str:
    return ">" + "".join(FORMATS[type_of(name)] for name in names)


class Controller:
    """The robot's box: what it is, and what it was told."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.begun = time.monotonic()
        self.pose = [0.4, -0.2, 0.3, 0.0, 3.0, 0.1]
        self.force = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
        self.script = 0  # bytes of URScript that came
        self.stopped = self.running = False
        self.says = 0  # of the script, in its first integer register
        self.commands: list[dict[str, Any]] = []  # that came in the registers
        self.watchdog: list[float] = []
        self.connections: list[socket.socket] = []

    def serve(self) -> None:
        for port, talk in ((29999, self.dashboard), (30001, self.take), (30002, self.take), (30003, self.take),
                           (30004, self.exchange)):  # fmt: skip
            server = socket.create_server((self.address, port), reuse_port=False)
            threading.Thread(target=self.accept, args=(server, talk), daemon=True).start()

    def accept(self, server: socket.socket, talk: Any) -> None:
        while True:
            one, _ = server.accept()
            self.connections.append(one)
            threading.Thread(target=self.talk, args=(talk, one), daemon=True).start()

    def talk(self, how: Any, one: socket.socket) -> None:
        try:
            how(one)
        except OSError:
            pass
        finally:
            one.close()

    def dashboard(self, one: socket.socket) -> None:
        one.sendall(b"Connected: Universal Robots Dashboard Server\n")
        with one.makefile("r") as lines:
            for line in lines:
                asked = line.strip().lower()
                answer = {
                    "polyscopeversion": f"URSoftware {'.'.join(map(str, SOFTWARE))} (Jul 06 2022)",
                    "get serial number": SERIAL,
                    "is in remote control": "true",
                    "running": f"Program running: {str(self.running).lower()}",
                }.get(asked, f"could not understand: '{asked}'")
                if asked == "stop":
                    self.running, answer = False, "Stopped"
                one.sendall(f"{answer}\n".encode())

    def take(self, one: socket.socket) -> None:
        while part := one.recv(65536):
            self.script += len(part)
            if b"end\n" in part:
                self.running, self.says = True, WAITING

    def exchange(self, one: socket.socket) -> None:
        """RTDE, package by package."""
        made = Exchange(self, one)
        with one.makefile("rb") as stream:
            while len(head := stream.read(3)) == 3:
                size, code = struct.unpack(">HB", head)
                body, kind = stream.read(size - 3), chr(code)
                if kind == "U":
                    self.told(made.inputs_in(body))
                else:
                    made.send(kind, made.answer(kind, body))
                if kind == "S":
                    threading.Thread(target=made.states, daemon=True).start()
        made.going.clear()

    def value(self, name: str) -> list[Any]:
        if name == "timestamp":
            return [time.monotonic() - self.begun]
        if name == "robot_status_bits":
            return [0b1011 if self.running else 0b1001]  # power, program, teach button, power button
        if name == "safety_status_bits":
            return [0b100 if self.stopped else 1]  # normal, reduced, protective stop, ...
        if name == "runtime_state":
            return [2 if self.running else 1]
        if name == "robot_mode":
            return [7]
        if name in ("actual_TCP_pose", "target_TCP_pose"):
            return list(self.pose)
        if name == "actual_TCP_force":
            return list(self.force)
        if name == "output_int_register_0":
            return [self.says]
        count = {"VECTOR6D": 6, "VECTOR6INT32": 6, "VECTOR6UINT32": 6, "VECTOR3D": 3}.get(type_of(name), 1)
        return [0] * count

    def told(self, values: dict[str, Any]) -> None:
        """Registers were written: a command, or the end of one."""
        code = next((value for name, value in values.items() if name == "input_int_register_0"), None)
        if code is None:
            return
        numbers = [value for name, value in values.items() if "double" in name]
        whole = [value for name, value in values.items() if "int_register" in name][1:]
        self.commands.append({"code": code, "at": time.monotonic() - self.begun, "doubles": numbers, "ints": whole})
        if code == 0:
            self.says = WAITING
        elif code == 255:
            self.running = False
        elif code not in REALTIME:
            self.says = DONE

    def answer(self, asked: dict[str, Any]) -> dict[str, Any]:
        if "pose" in asked:
            self.pose = list(asked["pose"])
        if "stop" in asked:
            self.stopped = bool(asked["stop"])
        if "cut" in asked:
            for one in self.connections:
                with suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)
        seen, self.commands = self.commands, []
        return {"commands": seen, "script": self.script, "running": self.running}


def main() -> None:
    made = Controller(sys.argv[1])
    made.serve()
    answer_lines(made.answer)


if __name__ == "__main__":
    main()
