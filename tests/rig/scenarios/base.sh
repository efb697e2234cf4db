#: title   the base driver on the kernel's SocketCAN, in virtual time
#: icount  1
#: modules can
#: seconds 300
can_up
"$HIL" rig-probe base --robot can0 --motors can1
