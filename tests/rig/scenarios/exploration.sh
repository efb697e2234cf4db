#: title   the deployed program explores a home: pictures by V4L2, scans by USB serial, motors by CAN
#: icount  0
#: seconds 3600
#: long
cabled_world_up
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
