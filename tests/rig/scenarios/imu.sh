#: title   the driver for inertial measurement units on the kernel's IIO (HID gyroscope)
#: icount  1
#: modules imu
#: seconds 120
"$HIL" rig-probe imu
