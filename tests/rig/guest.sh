# Sourced by every scenario in the guest. Starting a program there takes up to half a second, so combine checks.

# check CLAIM COMMAND...: prints one row of the table; the command's last line is its figure.
check() {
    local claim=$1 figure outcome=pass
    shift
    figure=$("$@" 2>&1 | tail -1; exit "${PIPESTATUS[0]}") || outcome=fail
    printf 'CHECK\t%s\t%s\t%s\n' "$outcome" "$claim" "$figure"
}

# camera_loop [WIDTH HEIGHT]: loops frames from /dev/video1 to /dev/video0: YUYV, 30 frames per second.
# HDMI input 1, no text in the image, 1280x720p30 (timing 5, the one in the list with 30 Hz) at both ends.
camera_loop() {
    local size=width=${1:-640},height=${2:-480},pixelformat=YUYV
    v4l2-ctl -d 0 -i 1 -c osd_text_mode=2,loop_video=1 >/dev/null
    local device
    for device in 0 1; do v4l2-ctl -d $device --set-dv-bt-timings index=5 >/dev/null; done
    v4l2-ctl -d 0 -v $size
    v4l2-ctl -d 1 -x $size
}

# can0 is the robot's end of the bus, can1 the motors'. A frame takes no time on the emulated bus, and a burst overruns the
# receiver. Frames are therefore sent at the bit rate, with 16 bytes per frame (111 bits or more on a real bus).
can_up() {
    modprobe sch_tbf
    local interface
    for interface in can0 can1; do
        ip link set $interface up type can bitrate 500000 restart-ms 100
        tc qdisc replace dev $interface root tbf rate 500kbit burst 16 limit 640
    done
}

# /dev/ttyUSB0 is the robot's end of the cable, /dev/ttyS1 the scanner's.
serial_up() {
    local port
    for port in /dev/ttyUSB0 /dev/ttyS1; do stty -F $port 115200 raw -echo; done
}

# Unplug the scanner's USB cable, and plug it in again.
serial_unplug() { echo 0 >/sys/bus/usb/devices/1-1/authorized; }
serial_plug() { echo 1 >/sys/bus/usb/devices/1-1/authorized; }

# world_up OPTIONS...: starts a robot's devices in a simulated home; $WORLD is its process, /tmp/world its folder.
world_up() {
    rm -f /tmp/world.log
    "$HIL" world --dir /tmp/world "$@" >/tmp/world.log 2>&1 &
    WORLD=$!
    until grep -qs ready /tmp/world.log; do
        kill -0 $WORLD || { cat /tmp/world.log; exit 1; }
        sleep 0.5
    done
}

# Ends the world and prints its last line: the driven distance and the number of touches.
world_down() {
    kill -INT $WORLD
    wait $WORLD
    grep '^world:' /tmp/world.log
}

# value KEY FILE: prints the value of a key in a JSON file with one key per line, or nothing.
value() { sed -n "s/^ *\"$1\": \(.*[^,]\),\?$/\1/p" "$2" | head -1; }

# until_value KEY FILE CONDITION: waits until an awk condition on that value, `v`, holds.
until_value() {
    until [ -s "$2" ] && awk -v v="$(value "$1" "$2")" "BEGIN { exit !($3) }"; do sleep 0.5; done
}

# punctuality FIRMWARE SECONDS: measures how late the safety loop runs while a robot drives, in parallel with cyclictest.
punctuality() {
    local firmware=$1 seconds=$2 robot steps missed worst missed_first worst_first
    rm -rf /tmp/run /rig/status.json
    world_up --lidar urg-04lx --protocol vesc --frame-size 160x64 --fps 10
    "$firmware" run --config /tmp/world/robot.toml --out /tmp/run --status /rig/status.json >/rig/run.log 2>&1 &
    robot=$!
    # Exclude the start, in which it allocates its memory at its own priority.
    until_value steps /rig/status.json 'v > 100'
    missed_first=$(value skipped /rig/status.json) worst_first=$(value worst_late_us /rig/status.json)
    # While both programs start, this slow machine may leave the motors silent for 100 ms; a request to arm is then cancelled.
    kill -USR1 $robot
    # At the safety loop's period, just above its priority (40). Below it, cyclictest would wait for the safety loop's
    # computation in every run in which the two happen to wake up together.
    cyclictest -m -q -p 41 -i 10000 -D $seconds -h 2000 >/tmp/cyclictest
    steps=$(value steps /rig/status.json) missed=$(value skipped /rig/status.json) worst=$(value worst_late_us /rig/status.json)
    kill -TERM $robot
    wait $robot
    world_down
    sed -n '/"safety_late"/,/}/p' /tmp/run/summary.json >/tmp/late

    check 'a robot drives meanwhile' \
        awk -F '[= ]' '/^world:/ { path_m = $3 } END { print path_m " m"; exit !(path_m > 0) }' /tmp/world.log
    check 'the safety loop at 100 Hz skips no step after its start' \
        awk -v first=$missed_first -v missed=$((missed - missed_first)) -v steps=$steps 'BEGIN {
            print missed " of " steps ", and " first " while the program started"; exit !(missed == 0) }'
    # If the largest delay is the one of the start, those after it are smaller than that.
    check 'the safety loop is less than 1 ms late after its start' \
        awk -v p50="$(value p50 /tmp/late)" -v p99="$(value p99 /tmp/late)" -v max="$worst" -v first="$worst_first" 'BEGIN {
            printf "p50 %.0f, p99 %.0f, max %.0f us, and %.0f us while the program started\n", 1000 * p50, 1000 * p99, max, first
            exit !(p99 > 0 && p99 < 1 && (max < 1000 || max == first)) }'
    check 'cyclictest in parallel at the same period is less than 1 ms late' awk '
        /^# Max/ { max = $NF + 0 }
        /^[0-9]/ { late[lines++] = $1 + 0; count[$1 + 0] = $2; all += $2 }
        END {
            for (i = 0; i < lines; i++) {
                seen += count[late[i]]
                if (p50 == "" && 2 * seen >= all) p50 = late[i]
                if (p99 == "" && seen >= 0.99 * all) p99 = late[i]
            }
            print "p50 " p50 ", p99 " p99 ", max " max " us of " all " wake-ups"
            exit !(all > 0 && max > 0 && max < 1000)
        }' /tmp/cyclictest
}
