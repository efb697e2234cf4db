#: title   the package under systemd: installation, start, supervision and removal
#: systemd
#: icount  0
#: seconds 1200
#: long
unit=embodied-depth status=/run/embodied-depth/status.json config=/etc/embodied-depth/robot.toml
state=/var/lib/embodied-depth
trap 'journalctl --no-pager >/rig/journal.log' EXIT
# property NAME: prints a systemd property of the service.
property() { systemctl show --value --property "$1" $unit; }
pid() { property MainPID; }
# until_restarted COUNT: waits until systemd has restarted the service COUNT times and it reports that it is up.
until_restarted() {
    until [ "$(property NRestarts)" -ge "$1" ] && [ "$(property ActiveState)" = active ]; do sleep 0.5; done
}
# driven: prints the driven distance, metres; the world reports it every ten seconds.
driven() { grep -o '[0-9.]* m driven' /tmp/world.log | tail -1; }

# This computer has two cameras; the first one is looped back.
mkdir -p /etc/udev/rules.d
echo 'SUBSYSTEM=="video4linux", KERNEL=="video0", OPTIONS+="link_priority=1"' >/etc/udev/rules.d/61-rig.rules
check 'the package installs' dpkg --install "$PACKAGE"
check 'it starts nothing' sh -c "! systemctl is-active $unit && ! systemctl is-enabled $unit"
udevadm settle
check 'udev names the camera, and assigns it to a group' sh -c "stat -L -c '%n is of %G' /dev/embodied-depth/camera | grep 'of video'"
check 'udev sets the bit rate of a CAN interface' sh -c 'ip -details link show can0 | grep -o "bitrate 500000"'
scanner=$(echo /dev/serial/by-id/usb-*)

restarts="after $(property RestartUSec), $(property StartLimitBurst) in $(property StartLimitIntervalUSec)"
check 'it is restarted as often as documented' sh -c "echo '$restarts'; [ '$restarts' = 'after 2s, 5 in 1min' ]"

# Frames of the emulated bus are sent at the bit rate; see guest.sh.
modprobe sch_tbf
for interface in can0 can1; do tc qdisc replace dev $interface root tbf rate 500kbit burst 16 limit 640; done
serial_up
camera_loop 160 64
world_up --lidar urg-04lx --protocol vesc --frame-size 160x64 --fps 15 --camera-at /dev/video1=/dev/embodied-depth/camera \
    --lidar-at "/dev/ttyS1=$scanner" --motors-at can1=can0
# The devices of this home, not armed at the start as in the package; vivid's camera delivers 30 frames per second.
sed -e 's/^fps = .*/fps = 30.0/' -e "s,^status_file.*,arm_at_start = false," -e '/^stop_file/d' /tmp/world/robot.toml >$config
# The default network needs larger frames than this machine can process; and five starts may take longer than the package's minute.
mkdir -p /etc/systemd/system/$unit.service.d
printf '[Unit]\nStartLimitIntervalSec=600\n[Service]\nEnvironment="ARGUMENTS=--policy active"\n' >/etc/systemd/system/$unit.service.d/rig.conf
systemctl daemon-reload

check 'it opens its devices as its own user' sh -c "
    runuser -u embodied-depth -- firmware-host check --devices --config $config >/rig/check.log 2>&1
    grep -c ' working ' /rig/check.log; [ \$(grep -c ' working ' /rig/check.log) = 3 ]"
# The restart time of a controller can be set only while its interface is down.
restart_after() { ip link set can0 down && ip link set can0 up type can bitrate 500000 restart-ms "$1"; }
restart_after 0
check 'it says that a CAN controller would stay off the bus' sh -c "
    runuser -u embodied-depth -- firmware-host check --devices --config $config | grep -o 'can0 stays off the bus.*is 0'"
restart_after 100
check 'and nothing of it where the controller restarts' sh -c "
    ! runuser -u embodied-depth -- firmware-host check --devices --config $config | grep 'off the bus'"
check 'systemd starts it and receives its readiness notification' sh -c "systemctl start $unit && systemctl is-active $unit"
check 'it runs as its own user, without capabilities, with a system call filter' awk '
    /^Uid/ { uid = $2 } /^CapEff/ { capabilities = $2 } /^Seccomp:/ { filter = $2 } /^NoNewPrivs/ { stuck = $2 }
    END {
        print "uid " uid ", capabilities " capabilities ", filter " filter
        exit !(uid > 0 && capabilities ~ /^0+$/ && filter == 2 && stuck == 1)
    }' "/proc/$(pid)/status"
check 'its safety loop has real-time priority, which needs no capability' sh -c "
    ps -L -o cls=,rtprio=,comm= -p $(pid) | grep 'FF.* safety'"
until_value ticks $status 'v > 20'
# A device may be late: all of them are simulated by one emulated processor.
check 'any user may query its health; it is healthy and not armed' sh -c "
    for second in \$(seq 30); do runuser -u nobody -- firmware-host health >/rig/health.log && break; sleep 1; done
    grep '^robot: healthy' /rig/health.log && grep '\"state\": \"disarmed' $status"
systemctl kill --signal=SIGUSR1 $unit
until_value state $status 'v ~ /clear|slow/'
until [ "$(driven)" ] && [ "$(driven)" != '0.0 m driven' ]; do sleep 0.5; done
check 'armed, it drives' driven

old=$(pid)
# Shorter than the watchdog time of systemd.
kill -STOP "$old"
sleep 3
kill -CONT "$old"
until_value state $status 'v ~ /fault/'
sleep 11
before=$(driven)
sleep 21
check 'stopped for 3 s and continued, it stands until it is armed' sh -c "
    echo '$before, then $(driven)'; [ '$before' = '$(driven)' ] && [ $(pid) = $old ] && grep -o '\"state\": \"fault.*paused[^\"]*' $status"
systemctl kill --signal=SIGUSR1 $unit
until_value state $status 'v ~ /clear|slow/'
until [ "$(driven)" != "$before" ]; do sleep 0.5; done
check 'armed again, it drives again' driven

kill -USR1 $WORLD
until_value state $status 'v ~ /fault/'
kill -USR2 $WORLD
# The world reports every ten seconds, and the wheels may roll for a few.
sleep 11
before=$(driven)
sleep 21
check 'motors that lost their power and got it back stand until a person arms the robot' sh -c "
    echo '$before, then $(driven)'; [ '$before' = '$(driven)' ] && grep -o '\"state\": \"fault[^\"]*' $status"
systemctl kill --signal=SIGUSR1 $unit
until_value state $status 'v ~ /clear|slow/'
until [ "$(driven)" != "$before" ]; do sleep 0.5; done
check 'armed once more, it drives' driven

kill -STOP "$old"
until_restarted 1
check 'a hung service is killed and restarted' sh -c "journalctl -u $unit | grep -o 'Watchdog timeout (limit 5s).*'"
until_value ticks $status 'v > 5'
# The world reports every ten seconds.
sleep 11
before=$(driven)
sleep 21
check 'a restarted service does not move until it is armed' sh -c "
    echo '$before, then $(driven)'; [ '$before' = '$(driven)' ] && grep -q '\"state\": \"disarmed' $status"
old=$(pid)
kill -KILL "$old"
until_restarted 2
check 'a killed service is restarted' sh -c "echo process $old, now $(pid); [ $(pid) -gt 0 ] && [ $(pid) != $old ]"
until_value ticks $status 'v > 5'
check 'it ends normally on systemctl stop' sh -c "systemctl stop $unit && systemctl show -p Result $unit | grep Result=success"
set -- $state/20*
check 'each start has recorded into its own folder' sh -c "
    stat -c %U $state/20* | sort | uniq -c | sed 's/^ *//' | grep -x '3 $unit'"
for run in "$1" "$3"; do firmware-host replay "$run"; done >/tmp/replay 2>&1
check 'the recording of a killed run replays, and that of a normal end' sh -c "
    grep -o 'ticks=.*' /tmp/replay | tr '\n' ' '; [ \$(grep -c mismatches=0 /tmp/replay) = 2 ]"

# Every restriction of the service, and ONNX Runtime.
sed -e 's/^Type=.*/Type=oneshot/' -e '/^Restart=\|^WatchdogSec=\|^NotifyAccess=/d' \
    -e 's,^ExecStart=.*,ExecStart=/usr/bin/firmware-host explore --scene builtin:apartment?seed=1 --frames 3 --no-recording --model /usr/share/embodied-depth/default.onnx --out /var/lib/embodied-depth/trial,' \
    /lib/systemd/system/$unit.service >/etc/systemd/system/trial.service
systemctl daemon-reload
check 'the network runs under all restrictions of the service' sh -c "
    systemctl start trial || { journalctl -u trial | tail -1; exit 1; }
    cp $state/trial/summary.json /rig && grep -q '\"depth_source\": \"network\"' /rig/summary.json || exit 1
    ! grep -A3 no_depth /rig/summary.json && sed -n '/\"network\": {/,/}/s/.*p50/per frame, ms: p50/p' /rig/summary.json | grep p50"

sed -i '1i no_such_key = 5' $config
systemctl reset-failed
systemctl start $unit 2>/dev/null
sleep 10
check 'an invalid configuration is reported once, without a restart' sh -c "
    echo exit $(property ExecMainStatus), $(property NRestarts) restarts, reported \$(journalctl -u $unit | grep -c no_such_key) times
    [ $(property NRestarts)$(property ExecMainStatus) = 02 ] && [ \$(journalctl -u $unit | grep -c no_such_key) = 1 ]"
sed -i 1d $config
check 'it starts when the configuration is corrected' sh -c "systemctl start $unit && systemctl is-active $unit"
until [ "$(property ActiveState)" = failed ]; do
    systemctl kill --signal=SIGKILL $unit 2>/dev/null
    sleep 1
done
check 'a service that dies repeatedly is not restarted' sh -c "journalctl -u $unit | grep -o 'Start request repeated too quickly.*'"
systemctl reset-failed $unit
systemctl start $unit
check 'removing the package stops it' sh -c "
    systemctl is-active $unit && dpkg --remove $unit >/rig/remove.log 2>&1 && ! systemctl is-active $unit && ! pgrep firmware-host"
dpkg --purge $unit >>/rig/remove.log 2>&1
check 'purged, it leaves recordings and nothing else' sh -c "
    ls -d $state/20* | wc -l | sed 's/\$/ recordings/'
    ls -d $state/20* >/dev/null && ! [ -e $config ] && ! [ -e /usr/bin/firmware-host ] && ! [ -e /lib/systemd/system/$unit.service ]"
