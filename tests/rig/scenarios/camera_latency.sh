#: title   a camera that stamps late: how much is measured, and with that depth is right
#: icount  0
#: seconds 1200
#: long
# vivid shows what was written to it a while ago, and stamps it now.
cabled_world_up --scene builtin:apartment?seed=2

# drive NAME POLICY FRAMES
drive() {
    "$FIRMWARE" run --config /tmp/world/robot.toml --out /tmp/$1 --policy $2 --frames $3 --status /rig/status.json >/rig/$1.log 2>&1
}
# agreement NAME: percent of depth that the LiDAR agrees with.
agreement() { sed -n 's/^  LiDAR agrees \([0-9]*\) %.*/\1/p' /rig/$1.log; }
# latency NAME: milliseconds to configure.
latency() { sed -n 's/^latency_ms = //p' /rig/$1.latency; }

drive turning random 600
"$FIRMWARE" camera-latency /tmp/turning >/rig/turning.latency 2>&1
check 'the latency of its camera is found while the robot turns to and fro' awk -v ms="$(latency turning)" '
    { text = text " " $0 } END { print substr(text, 2, 78); exit !(ms > 10) }' /rig/turning.latency
drive before active 600
sed -i "s/^\[devices.camera\]/&\nlatency_ms = $(latency turning)/" /tmp/world/robot.toml
drive after active 600
world_down >/tmp/end
check 'the LiDAR then agrees with more of the depth' awk -v before="$(agreement before)" -v after="$(agreement after)" '
    BEGIN { print before " %, then " after " %"; exit !(before != "" && after > before + 5) }'
check 'a second measurement finds little more to correct' awk -v was="$(latency turning)" '
    /^(Pictures|The wheels)/ { ms = /^Pictures/ ? $4 : -$4 } END { print was " ms, then " ms " ms"; exit !(ms > was - 10 && ms < was + 10) }' \
    <("$FIRMWARE" camera-latency /tmp/after 2>&1)
