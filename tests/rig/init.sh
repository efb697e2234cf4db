#!/bin/sh
# The guest's init, in busybox: loads the device drivers, mounts the host's root as the guest's (read-only, with a tmpfs
# above it), runs /rig/commands in it, and powers the machine off.
# /rig/environment sets MODULES (groups to load), VIVID (its parameters), KERNEL_MODULES (path of the other modules) and
# SYSTEMD: `yes` makes systemd the first process, which runs the commands and powers off.
mount -t proc p /proc
mount -t sysfs s /sys
mount -t devtmpfs d /dev

load() {
    while read -r module; do
        case $module in vivid.ko) set -- $VIVID ;; *) set -- ;; esac
        insmod "/modules/$module" "$@" 2>/dev/null
    done <"/modules/$1"
}

load base
mkdir -p /dev/pts /dev/shm
nine=trans=virtio,version=9p2000.L,msize=512000
mount -t 9p -o $nine,ro,cache=loose root /host
mount -t tmpfs -o size=60% t /above
mkdir /above/upper /above/work
mount -t overlay -o lowerdir=/host,upperdir=/above/upper,workdir=/above/work o /root
mkdir -p /root/rig /root/lib/modules
mount -t 9p -o $nine,cache=none rig /root/rig
. /root/rig/environment
for group in $MODULES; do load "$group"; done

mount -t devpts d /dev/pts
mount -t debugfs d /sys/kernel/debug
for folder in dev proc sys; do mount -o rbind /$folder /root/$folder; done
for folder in dev/shm tmp run; do mount -t tmpfs t /root/$folder; done
mount -o bind "/host$KERNEL_MODULES" /root/lib/modules
hostname rig
ip link set lo up
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C
# busybox does not expand globs in redirections.
set -- /dev/vport*p1
if [ "$SYSTEMD" ]; then
    # Start no unit of the host's own configuration.
    rm -rf /root/etc/systemd/system
    mkdir -p /root/etc/systemd/system
    for unit in systemd-hwdb-update systemd-journal-catalog-update ldconfig; do
        ln -s /dev/null /root/etc/systemd/system/$unit.service
    done
    : >/root/etc/fstab
    echo 00000000000000000000000000000001 >/root/etc/machine-id
    cat >/root/etc/systemd/system/default.target <<EOF
[Unit]
Requires=basic.target
Wants=rig.service
After=basic.target
AllowIsolate=yes
EOF
    cat >/root/etc/systemd/system/rig.service <<EOF
[Unit]
After=basic.target systemd-udev-settle.service
Wants=systemd-udev-settle.service
SuccessAction=poweroff-force
FailureAction=poweroff-force
[Service]
Type=oneshot
Environment=HOME=/root LC_ALL=C
ExecStart=/bin/bash /rig/commands
StandardOutput=file:$1
StandardError=inherit
EOF
    exec switch_root /root /lib/systemd/systemd
fi
chroot /root /bin/bash /rig/commands >"$1" 2>&1 </dev/null
echo $? >/root/rig/status
sync
poweroff -f
