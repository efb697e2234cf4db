#: title   the deployed program explores a home: pictures by V4L2, scans by USB serial, motors by CAN
#: icount  0
#: seconds 3600
#: long
# Names that stay the same over a replug, as udev makes them.
mkdir -p /dev/v4l/by-id /dev/serial/by-id
ln -sf /dev/video0 /dev/v4l/by-id/rig
ln -sf /dev/ttyUSB0 /dev/serial/by-id/usb-Hokuyo
camera_loop 160 64
can_up
serial_up
# The scanner that the emulated port is fast enough for.
world_up --lidar urg-04lx --protocol vesc --picture 160x64 --fps 15 --camera-at /dev/video1=/dev/v4l/by-id/rig \
    --lidar-at /dev/ttyS1=/dev/serial/by-id/usb-Hokuyo --motors-at can1=can0
# vivid's camera gives 30 pictures a second: each of the world's twice.
sed -i 's/^fps = .*/fps = 30.0/' /tmp/world/robot.toml
# The status lies outside of this machine: so one can watch.
"$FIRMWARE" run --config /tmp/world/robot.toml --out /tmp/run --status /rig/status.json --frames 3000 \
    --fault random --fault-seed 1 >/rig/run.log 2>&1
status=$?
cat /rig/run.log
summary=/tmp/run/summary.json
check 'it explores for as many pictures as it was told' sh -c "grep '\"frames\"' $summary; exit $status"
world_down >/tmp/end
check 'it gets somewhere' awk -F'[= ]' '/^world:/ { print $3 " m"; far = $3 > 1 } END { exit !far }' /tmp/end
check 'it touches nothing' sh -c 'cat /tmp/end; grep -q "touches=0" /tmp/end'
"$FIRMWARE" replay /tmp/run >/tmp/replay 2>&1
check 'its recording replays to the same decisions' sh -c 'cat /tmp/replay; grep -q mismatches=0 /tmp/replay'
