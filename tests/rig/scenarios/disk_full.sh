#: title   the disk is full while the robot records
#: modules
#: disk    16
#: seconds 240
mkdir -p /mnt/disk
mkfs.ext4 -q -O ^has_journal /dev/vda
mount /dev/vda /mnt/disk
world_up --picture 160x64
status=/tmp/world/status.json
"$FIRMWARE" run --config /tmp/world/robot.toml --out /mnt/disk/run >/tmp/run.log 2>&1 &
robot=$!
# Little is left once it drives.
until_value ticks $status 'v > 30'
fallocate -l "$(($(df --output=avail -B1 /mnt/disk | tail -1) - 600000))" /mnt/disk/ballast
until_value failure $status 'v != "" && v != "null"'
check 'health is unwell, and says why and where' sh -c "! '$FIRMWARE' health --status $status >/tmp/health; grep recorded: /tmp/health"
before=$(value ticks $status)
until_value ticks $status "v > $before + 50"
check 'the robot drives on' awk -v s="$(value state $status)" 'BEGIN { print s; exit !(s == "\"clear\"" || s == "\"slow\"") }'
cp -r /mnt/disk/run /tmp/left
"$FIRMWARE" replay /tmp/left >/tmp/replay 2>&1
check 'what was recorded is whole, and replays' sh -c 'cat /tmp/replay; grep -q mismatches=0 /tmp/replay'
rm /mnt/disk/ballast
kill -TERM $robot
check 'it ends as it was told, and says that the recording is not whole' sh -c "wait; grep -i record /tmp/run.log"
wait $robot || exit 1
world_down
