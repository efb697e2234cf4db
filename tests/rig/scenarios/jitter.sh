#: title   the safety loop's punctuality on PREEMPT_RT, in virtual time
#: kernel  rt
#: icount  1
#: modules
#: seconds 400
punctuality "$FIRMWARE" 10
