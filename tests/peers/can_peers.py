"""Checks the simulated motor controllers and our frames with python-can, canopen, cantools and crccheck.

    can_peers.py odrive|vesc|cia402 SOCKET   controls the simulated node 1 on a Unix CAN bus
    can_peers.py frames DBC FILE             decodes our frames; lines: candump's notation and the fields as JSON
    can_peers.py driver FILE                 decodes what our driver sends to ODrives, with ODrive's DBC file
"""

import json
import logging
import socket
import struct
import sys
import time
from importlib.resources import files

import can
import canopen
import cantools
from canopen.objectdictionary import ODRecord, ODVariable, ObjectDictionary, datatypes
from canopen.profiles.p402 import BaseNode402
from crccheck.crc import Crc8SaeJ1850, CrcXmodem

RECORD = struct.Struct("=IB3x8s")


class UnixBus(can.BusABC):
    """A CAN bus of Linux's `struct can_frame` records over a Unix seqpacket socket."""

    def __init__(self, path):
        super().__init__(channel=path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.connect(path)

    def send(self, msg, timeout=None):
        flags = msg.is_extended_id << 31 | msg.is_remote_frame << 30
        self._socket.send(RECORD.pack(msg.arbitration_id | flags, msg.dlc, bytes(msg.data).ljust(8, b"\0")))

    def _recv_internal(self, timeout):
        self._socket.settimeout(timeout)
        try:
            record = self._socket.recv(16)
        except (TimeoutError, BlockingIOError):
            return None, False
        if not record:
            raise can.CanOperationError("the bus is closed")
        number, length, data = RECORD.unpack(record)
        return can.Message(timestamp=time.time(), arbitration_id=number & 0x1FFFFFFF, is_extended_id=bool(number >> 31),
                           is_remote_frame=bool(number >> 30 & 1), dlc=length, data=data[:length]), False

    def shutdown(self):
        super().shutdown()
        self._socket.close()


def check(what, holds):
    if not holds:
        sys.exit(f"FAILED: {what}")
    print(f"  {what}")


def wait(bus, accepts, seconds=2.0, feed=None):
    """Returns the first accepted message, or None after `seconds`; calls `feed` every 10 ms meanwhile."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if feed:
            feed()
        message = bus.recv(0.01)
        if message and accepts(message):
            return message
    return None


def odrive_database():
    return cantools.database.load_file(files("odrive_can").joinpath("dbc", "odrive-cansimple-0.6.10.dbc"))


def odrive(path):
    database = odrive_database()
    bus = UnixBus(path)

    def send(name, **signals):
        message = database.get_message_by_name(f"Axis1_{name}")
        bus.send(can.Message(arbitration_id=message.frame_id, is_extended_id=False, data=message.encode(signals)))

    def receive(name, accepts=None, **options):
        message = database.get_message_by_name(f"Axis1_{name}")
        found = {}

        def matches(frame):
            if frame.arbitration_id == message.frame_id and not frame.is_remote_frame:
                found.update(message.decode(frame.data, decode_choices=False))
                return accepts is None or accepts(found)
            return False

        return found if wait(bus, matches, **options) else None

    bus.send(can.Message(arbitration_id=0x20, is_extended_id=False, is_remote_frame=True, dlc=8))
    version = receive("Get_Version")
    check("Get_Version answers firmware 0.6.10", version and version["Fw_Version_Minor"] == 6 and version["Fw_Version_Revision"] == 10)
    check("the heartbeat reports idle without an error", receive("Heartbeat", lambda s: s["Axis_State"] == 1 and s["Axis_Error"] == 0))
    send("RxSdo", Opcode=1, Endpoint_ID=196, Reserved=0, Value=struct.unpack("<I", struct.pack("<f", 0.3))[0])
    send("RxSdo", Opcode=0, Endpoint_ID=196, Reserved=0, Value=0)
    answer = receive("TxSdo", lambda s: s["Endpoint_ID"] == 196)
    check("the watchdog time reads back as 0.3 s", answer and abs(struct.unpack("<f", struct.pack("<I", answer["Value"]))[0] - 0.3) < 1e-6)
    def feed():
        send("Set_Input_Vel", Input_Vel=2.0, Input_Torque_FF=0.0)

    feed()
    send("RxSdo", Opcode=1, Endpoint_ID=195, Reserved=0, Value=1)
    send("Set_Controller_Mode", Control_Mode=2, Input_Mode=1)
    send("Clear_Errors", Identify=0)
    send("Set_Axis_State", Axis_Requested_State=8)
    check("with commands, the axis reaches 2 revolutions per second", receive("Get_Encoder_Estimates", lambda s: abs(s["Vel_Estimate"] - 2) < 0.02, feed=feed))
    check("the axis stays in closed-loop control", receive("Heartbeat", lambda s: s["Axis_State"] == 8 and s["Axis_Error"] == 0, feed=feed))
    check("without commands, the watchdog disarms the axis", receive("Heartbeat", lambda s: s["Axis_State"] == 1 and s["Axis_Error"] == 0x1000000))
    # The released wheel coasts with a time constant of 0.5 s: from 2 to 0.01 revolutions per second in 2.7 s.
    check("the wheel stops", receive("Get_Encoder_Estimates", lambda s: abs(s["Vel_Estimate"]) < 0.01, seconds=6.0))
    bus.shutdown()


def vesc(path):
    bus = UnixBus(path)
    host = 99

    def send(packet, payload):
        bus.send(can.Message(arbitration_id=packet << 8 | 1, is_extended_id=True, data=payload))

    send(8, bytes([host, 0, 17]))
    buffer = bytearray(1024)
    answer = None
    while answer is None:
        message = wait(bus, lambda m: m.arbitration_id & 0xFF == host)
        if not message:
            check("the configuration is received", False)
        kind = message.arbitration_id >> 8
        data = bytes(message.data)
        if kind == 5:
            buffer[data[0]:data[0] + len(data) - 1] = data[1:]
        elif kind == 6:
            at = int.from_bytes(data[:2], "big")
            buffer[at:at + len(data) - 2] = data[2:]
        elif kind == 7:
            length, crc = struct.unpack(">HH", data[2:6])
            answer = bytes(buffer[:length])
            check(f"the configuration's {length} bytes match their CRC", CrcXmodem.calc(answer) == crc)
    command, _, controller, timeout_ms, brake_a = struct.unpack(">BIBIf", answer[:14])
    check("it contains controller 1, a time-out of 100 ms and a brake current", (command, controller, timeout_ms, brake_a > 0) == (17, 1, 100, True))

    def feed():
        send(3, struct.pack(">i", 840))

    def speed(message):
        """The electrical speed in a status message, None for other messages."""
        if message.arbitration_id != 9 << 8 | 1:
            return None
        return struct.unpack(">i", bytes(message.data)[:4])[0]

    def is_at_speed(message):
        erpm = speed(message)
        return erpm is not None and abs(erpm - 840) < 10

    check("with commands, it reaches 840 ERPM", wait(bus, is_at_speed, feed=feed))
    check("without commands, it brakes to standstill", wait(bus, lambda message: speed(message) == 0))
    bus.shutdown()


def dictionary():
    """The part of the object dictionary of CiA 301 and 402 that is used here."""
    od = ObjectDictionary()

    def variable(parent, name, index, sub, kind):
        entry = ODVariable(name, index, sub)
        entry.data_type = kind
        parent.add_object(entry) if sub == 0 and parent is od else parent.add_member(entry)

    for index, name, kind in [(0x1000, "Device type", datatypes.UNSIGNED32), (0x1017, "Producer heartbeat", datatypes.UNSIGNED16),
                              (0x1234, "Nothing", datatypes.UNSIGNED16), (0x6040, "Controlword", datatypes.UNSIGNED16),
                              (0x6041, "Statusword", datatypes.UNSIGNED16), (0x6060, "Modes of operation", datatypes.INTEGER8),
                              (0x6061, "Modes display", datatypes.INTEGER8), (0x6064, "Position", datatypes.INTEGER32),
                              (0x606C, "Velocity", datatypes.INTEGER32), (0x60FF, "Target velocity", datatypes.INTEGER32)]:
        variable(od, name, index, 0, kind)
    records = [(0x1016, "Consumer heartbeat", [datatypes.UNSIGNED32])]
    for k, (communication, mapping) in enumerate([(0x1400, 0x1600), (0x1800, 0x1A00), (0x1801, 0x1A01)]):
        records.append((communication, f"PDO {k}", [datatypes.UNSIGNED32, datatypes.UNSIGNED8]))
        records.append((mapping, f"Mapping {k}", [datatypes.UNSIGNED32, datatypes.UNSIGNED32]))
    for index, name, kinds in records:
        record = ODRecord(name, index)
        od.add_object(record)
        for sub, kind in enumerate([datatypes.UNSIGNED8, *kinds]):
            variable(record, f"{name} {sub}", index, sub, kind)
    return od


def cia402(path):
    logging.disable(logging.WARNING)
    network = canopen.Network()
    network.bus = UnixBus(path)
    network.connect()
    node = network.add_node(BaseNode402(1, dictionary()))
    node.sdo.RESPONSE_TIMEOUT = 1.0
    check("the device type is that of a servo drive", node.sdo[0x1000].raw == 0x00020192)
    node.sdo[0x1017].raw = 50
    check("its heartbeat time is read back", node.sdo[0x1017].raw == 50)
    node.nmt.send_command(0x80)
    node.nmt.wait_for_heartbeat(2)
    check("NMT sets it to pre-operational", node.nmt.state == "PRE-OPERATIONAL")
    try:
        node.sdo[0x1234].raw
        check("an unknown object is refused", False)
    except canopen.SdoAbortedError as refusal:
        check("an unknown object is refused by its code", refusal.code == 0x06020000)
    node.tpdo.read()
    node.rpdo.read()
    node.tpdo[1].clear()
    node.tpdo[1].add_variable(0x6041)
    node.tpdo[1].add_variable(0x606C)
    node.tpdo[1].trans_type = 1
    node.tpdo[1].enabled = True
    node.rpdo[1].clear()
    node.rpdo[1].add_variable(0x6040)
    node.rpdo[1].add_variable(0x60FF)
    node.rpdo[1].enabled = True
    node.tpdo[1].save()
    node.rpdo[1].save()
    check("its PDOs can be remapped", [v.index for v in node.tpdo[1]] == [0x6041, 0x606C])
    node.setup_402_state_machine()
    node.sdo[0x6060].raw = 3
    node.nmt.state = "OPERATIONAL"
    network.sync.start(0.01)
    beat = network.send_periodic(0x700 + 42, [5], 0.02)
    node.sdo[0x1016][1].raw = 42 << 16 | 100
    node.state = "OPERATION ENABLED"
    check("canopen's own CiA 402 state machine enables it", node.state == "OPERATION ENABLED")
    node.rpdo[1][0x60FF].raw = 8192
    node.rpdo[1].transmit()
    time.sleep(0.4)
    check("it runs at the target velocity", abs(node.tpdo[1][0x606C].raw - 8192) < 100)
    beat.stop()
    time.sleep(0.5)
    check("without our heartbeat it goes to fault", node.state == "FAULT")
    check("it stops", abs(node.sdo[0x606C].raw) < 20)
    check("its emergency message gives the cause", any(error.code == 0x8130 for error in node.emcy.log))
    network.sync.stop()
    network.disconnect()


def frames(dbc, path):
    database = cantools.database.load_file(dbc)
    count = 0
    for line in open(path):
        number, _, rest = line.partition("#")
        data, _, fields = rest.partition(" ")
        data = bytes.fromhex(data)
        number = int(number, 16)
        message = database.get_message_by_frame_id(number)
        signals = message.decode(data, decode_choices=False)
        for name, value in json.loads(fields).items():
            if abs(signals[name] - value) > 1e-9:
                sys.exit(f"FAILED: {message.name}.{name} is {signals[name]}, written {value}")
        if Crc8SaeJ1850.calc(struct.pack("<I", number) + data[1:]) != data[0]:
            sys.exit(f"FAILED: {line.strip()} does not match its checksum")
        if message.encode(signals) != data:
            sys.exit(f"FAILED: {line.strip()} differs from the encoding by cantools")
        count += 1
    check(f"cantools and crccheck agree on {count} frames", count > 100)


def driver(path):
    database = odrive_database()
    names = set()
    speeds = set()
    for line in open(path):
        number, _, data = line.strip().partition("#")
        if len(number) != 3 or data.startswith("R"):
            continue
        message = database.get_message_by_frame_id(int(number, 16))
        signals = message.decode(bytes.fromhex(data).ljust(message.length, b"\0"), decode_choices=False)
        names.add(message.name)
        if message.name == "Axis1_Set_Input_Vel":
            speeds.add(round(signals["Input_Vel"], 3))
        if message.name == "Axis1_Set_Controller_Mode":
            check("velocity control, passed through", (signals["Control_Mode"], signals["Input_Mode"]) == (2, 1))
    expected = {f"Axis{k}_{name}" for k in (1, 2) for name in
                ("RxSdo", "Set_Axis_State", "Set_Controller_Mode", "Set_Input_Vel", "Clear_Errors")}
    check("the driver sends these messages and no others", names == expected)
    check("its speeds run from 0 to 0.2 m/s over 5 cm wheels", min(speeds) == 0 and abs(max(speeds) - 0.637) < 1e-3)


if __name__ == "__main__":
    {"odrive": odrive, "vesc": vesc, "cia402": cia402, "frames": frames, "driver": driver}[sys.argv[1]](*sys.argv[2:])
