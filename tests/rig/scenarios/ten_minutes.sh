#: title   the safety loop's punctuality on PREEMPT_RT for ten minutes of virtual time
#: kernel  rt
#: icount  1
#: modules
#: seconds 6000
#: long
punctuality "$FIRMWARE" 600
