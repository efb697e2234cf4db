#: title   a power cut while the robot records on ext4
#: modules
#: disk    256
#: seconds 400
mkdir -p /mnt/disk
if [ ! -e /rig/after_power_cut ]; then
    mkfs.ext4 -q /dev/vda
    mount /dev/vda /mnt/disk
    world_up --frame-size 160x64
    # The status is outside of this machine: it shows later how many ticks the robot had run.
    "$FIRMWARE" run --config /tmp/world/robot.toml --out /mnt/disk/run --status /rig/status.json >/rig/run.log 2>&1 &
    until_value ticks /rig/status.json 'v > 150'
    echo 'POWER CUT'
    sleep 60
    exit 1
fi
check 'ext4 recovers automatically' mount /dev/vda /mnt/disk
"$FIRMWARE" replay /mnt/disk/run >/tmp/replay 2>&1
cat /tmp/replay
check 'the recording opens and replays up to the cut' sh -c 'grep mismatches /tmp/replay; grep -q mismatches=0 /tmp/replay'
kept=$(sed -n 's/.*truncated after \(turn\|tick\) \([0-9]*\).*/\2/p' /tmp/replay)
# The status is written twice a second: five ticks may have followed it. 26: firmware-host/src/record/mod.rs.
check 'at most 2.6 s (26 ticks) of the recording are lost' \
    awk -v seen="$(value ticks /rig/status.json)" -v kept="$kept" 'BEGIN {
        print seen + 5 - kept " of at most " seen + 5 " ticks"; exit !(kept > 0 && seen + 5 - kept <= 26) }'
umount /mnt/disk
check 'the file system is consistent' sh -c 'e2fsck -fn /dev/vda 2>&1'
