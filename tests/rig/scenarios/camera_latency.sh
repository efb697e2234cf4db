#: title   a camera that stamps late: how late is measured, and with that pictures and wheels agree
#: icount  0
#: seconds 1200
#: long
# vivid shows what was written to it a while ago, and stamps it now.
cabled_world_up

# measured NAME: drives to and fro for a minute; /rig/NAME.latency then says how late the camera is.
measured() {
    "$FIRMWARE" run --config /tmp/world/robot.toml --out /tmp/$1 --policy random --frames 600 --status /rig/status.json >/rig/$1.log 2>&1
    "$FIRMWARE" camera-latency /tmp/$1 >/rig/$1.latency 2>&1
}
# latency NAME: milliseconds that pictures are late. within NAME: turns as configured, milliradians.
latency() { awk '/^Pictures/ { print $4 } /^The wheels/ { print -$4 }' /rig/$1.latency; }
within() { sed -n 's/.*with latency_ms = .* within \([0-9.]*\)\./\1/p' /rig/$1.latency; }

measured as_stamped
was=$(latency as_stamped)
check 'how late its camera is, is found while the robot turns to and fro' \
    awk -v ms="$was" 'BEGIN { print ms " ms"; exit !(ms > 10) }'
sed -i "s/^\[devices.camera\]/&\nlatency_ms = $was/" /tmp/world/robot.toml
measured corrected
world_down >/tmp/end
check 'pictures then turn with the wheels' awk -v was="$(within as_stamped)" -v is="$(within corrected)" '
    BEGIN { print "nine of ten turns within " was " mrad, then " is; exit !(is > 0 && is < 0.8 * was) }'
check 'a second measurement finds the same' awk -v was="$was" -v is="$(latency corrected)" '
    BEGIN { print was " ms, then " is " ms"; exit !(is != "" && is > was - 15 && is < was + 15) }'
