#: title   the safety loop's punctuality on PREEMPT_RT, in virtual time
#: kernel  rt
#: icount  1
#: modules
#: seconds 400
world_up --picture 160x64
# Just below the safety loop's priority, at its pace.
cyclictest -m -q -p 39 -i 10000 -D 60 -h 2000 >/tmp/cyclictest &
"$FIRMWARE" run --config /tmp/world/robot.toml --out /tmp/run --status /tmp/status.json >/tmp/run.log 2>&1 &
robot=$!
until_value turns /tmp/status.json 'v > 5900'
missed=$(value skipped /tmp/status.json) turns=$(value turns /tmp/status.json)
kill -TERM $robot
wait
cat /tmp/run.log
