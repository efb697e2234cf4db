#: title   the deployed program explores a home: pictures by V4L2, scans by USB serial, motors by CAN
#: icount  1
#: seconds 900
#: long
# Names that stay the same over a replug, as udev makes them.
mkdir -p /dev/v4l/by-id /dev/serial/by-id
ln -sf /dev/video0 /dev/v4l/by-id/rig
ln -sf /dev/ttyUSB0 /dev/serial/by-id/usb-Hokuyo
camera_loop 160 64
can_up
serial_up
# The scanner that the emulated port is fast enough for, the motors that the emulated bus can carry.
world_up --lidar urg-04lx --protocol vesc --picture 160x64 --fps 15 --camera-at /dev/video1=/dev/v4l/by-id/rig \
    --lidar-at /dev/ttyS1=/dev/serial/by-id/usb-Hokuyo --motors-at can1=can0

# explored NAME OPTIONS...: a run of its own, and what must be true of it.
explored() {
    local name=$1 out=/tmp/run-$1
    shift
    "$FIRMWARE" run --config /tmp/world/robot.toml --out $out "$@" >$out.log 2>&1
    local status=$?
    tail -40 $out.log
    check "$name: it explores for as many pictures as it was told" [ $status = 0 ]
    check "$name: it gets somewhere" awk -v m="$(value path_m $out/summary.json)" 'BEGIN { print m " m"; exit !(m > 1) }'
    check "$name: replay on the same machine gives the same decisions" \
        sh -c "'$FIRMWARE' replay $out >$out.replay 2>&1; grep -o '[a-z]*=.*' $out.replay | tail -1; grep -q mismatches=0 $out.replay"
}
explored quiet --frames 300
explored faults --frames 600 --seed 2 --fault random --fault-seed 1
world_down >/tmp/end
check 'it touches nothing' sh -c 'cat /tmp/end; grep -q "touches=0" /tmp/end'
