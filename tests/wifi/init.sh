#!/bin/busybox sh
# First process of the guest: modules, the host's / read-only under a tmpfs overlay, then the job of the share.
bb=/bin/busybox
$bb mount -t proc proc /proc
$bb mount -t sysfs sysfs /sys
$bb mount -t devtmpfs dev /dev
while read -r name; do $bb insmod "/modules/$name.ko" || echo "guest: $name not loaded"; done < /modules/order
$bb mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=524288 hostroot /lower || echo "guest: no host root"
$bb mount -t tmpfs -o size=75% tmpfs /upper
$bb mkdir -p /upper/data /upper/work
$bb mount -t overlay -o lowerdir=/lower,upperdir=/upper/data,workdir=/upper/work overlay /root
$bb mkdir -p /root/proc /root/sys /root/dev /root/run /root/result /root/guest-modules
for each in proc sys dev; do $bb mount -o move /$each /root/$each; done
$bb mount -t tmpfs tmpfs /root/run
$bb mkdir -p /root/dev/pts /root/dev/shm
$bb mount -t devpts devpts /root/dev/pts
$bb mount -t tmpfs tmpfs /root/dev/shm
$bb mount -t debugfs debugfs /root/sys/kernel/debug
$bb mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288 result /root/result
$bb cp /modules/mac80211_hwsim.ko /root/guest-modules/
$bb ip link set lo up
$bb hostname guest
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8
echo "guest: up after $($bb cut -d' ' -f1 /root/proc/uptime) s"
$bb chroot /root /bin/sh /result/job
echo "$?" > /root/result/exit
$bb dmesg > /root/result/dmesg
$bb sync
$bb poweroff -f
