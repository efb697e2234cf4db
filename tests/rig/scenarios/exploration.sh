#: title   the deployed program explores a home: camera by V4L2, scans by USB serial, motors by CAN
#: icount  0
#: seconds 3600
#: long
# Names that are stable over a replug, as udev creates them.
mkdir -p /dev/v4l/by-id /dev/serial/by-id
ln -sf /dev/video0 /dev/v4l/by-id/rig
ln -sf /dev/ttyUSB0 /dev/serial/by-id/usb-Hokuyo
camera_loop 160 64
can_up
serial_up
# A scanner for which the emulated port is fast enough.
world_up --lidar urg-04lx --protocol vesc --frame-size 160x64 --fps 15 --camera-at /dev/video1=/dev/v4l/by-id/rig \
    --lidar-at /dev/ttyS1=/dev/serial/by-id/usb-Hokuyo --motors-at can1=can0
# vivid's camera delivers 30 frames per second: each of the world's frames twice.
sed -i 's/^fps = .*/fps = 30.0/' /tmp/world/robot.toml
# The status is outside of this machine, so it can be watched.
"$FIRMWARE" run --config /tmp/world/robot.toml --out /tmp/run --status /rig/status.json --frames 3000 \
    --fault random --fault-seed 1 >/rig/run.log 2>&1
status=$?
cat /rig/run.log
summary=/tmp/run/summary.json
check 'it explores for the requested number of frames' sh -c "grep '\"frames\"' $summary; exit $status"
world_down >/tmp/end
check 'it drives more than 1 m' awk -F'[= ]' '/^world:/ { print $3 " m"; far = $3 > 1 } END { exit !far }' /tmp/end
check 'it touches nothing' sh -c 'cat /tmp/end; grep -q "touches=0" /tmp/end'
"$FIRMWARE" replay /tmp/run >/tmp/replay 2>&1
check 'its recording replays to the same decisions' sh -c 'cat /tmp/replay; grep -q mismatches=0 /tmp/replay'
