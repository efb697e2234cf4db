#: title   the disk is full while the robot records
#: icount  0
#: modules
#: seconds 600
mkdir -p /mnt/disk
mount -t tmpfs -o size=8m disk /mnt/disk
world_up --lidar urg-04lx --protocol vesc --frame-size 160x64 --fps 10
status=/rig/status.json
"$FIRMWARE" run --config /tmp/world/robot.toml --out /mnt/disk/run --status $status >/rig/run.log 2>&1 &
robot=$!
# Fill the disk once the robot drives, and keep the first segment from being deleted.
until_value ticks $status 'v > 30'
touch /mnt/disk/run/recording_0000.mcap.keep
fallocate -l "$(($(df --output=avail -B1 /mnt/disk | tail -1) - 200000))" /mnt/disk/ballast
until_value failure $status 'v != "" && v != "null"'
"$FIRMWARE" health --status $status >/tmp/health && touch /tmp/well
check 'health is unhealthy, and reports that nothing is recorded and why' \
    sh -c '! [ -e /tmp/well ] && grep "nothing is recorded" /tmp/health'
cp -r /mnt/disk/run /tmp/left
"$FIRMWARE" replay /tmp/left >/tmp/replay 2>&1
check 'what was recorded until then is valid, and replays' sh -c 'cat /tmp/replay; grep -q mismatches=0 /tmp/replay'
ticks=$(value ticks $status)
until_value ticks $status "v > $ticks + 20"
check 'the robot continues to drive' awk -v state="$(value state $status)" 'BEGIN { print state; exit state !~ /clear|slow/ }'
rm /mnt/disk/ballast
kill -TERM $robot
wait $robot
ended=$?
check 'it ends normally on SIGTERM, and reports what is missing' sh -c "grep -i warning: /rig/run.log; exit $ended"
world_down
