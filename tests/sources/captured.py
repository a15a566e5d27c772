"""Texts as kernels really gave them."""
# ruff: noqa: E501

# Linux 6.18, x86-64
NETDEV = b"""Inter-|   Receive                                                |  Transmit
 face |bytes    packets errs drop fifo frame compressed multicast|bytes    packets errs drop fifo colls carrier compressed
    lo:    3393      33    0    0    0     0          0         0     3393      33    0    0    0     0       0          0
  eth0: 477108295   13206    0    0    0     0          0         0   828441    8209    0    0    0     0       0          0
 wlan0:    9001      12    1    2    0     0          0         0      800       9    3    4    0     0       0          0
wlan01:       5       1    0    0    0     0          0         0        6       1    0    0    0     0       0          0
"""

SNMP = b"""Ip: Forwarding DefaultTTL InReceives InHdrErrors InAddrErrors ForwDatagrams InUnknownProtos InDiscards InDelivers OutRequests OutDiscards OutNoRoutes ReasmTimeout ReasmReqds ReasmOKs ReasmFails FragOKs FragFails FragCreates OutTransmits
Ip: 2 64 13233 0 0 0 0 0 13233 8228 0 0 0 0 0 0 0 0 0 8228
IcmpMsg: InType3
IcmpMsg: 1
Tcp: RtoAlgorithm RtoMin RtoMax MaxConn ActiveOpens PassiveOpens AttemptFails EstabResets CurrEstab InSegs OutSegs RetransSegs InErrs OutRsts InCsumErrors
Tcp: 1 200 120000 -1 66 2 2 0 0 13071 8105 7 3 117 0
Udp: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors SndbufErrors InCsumErrors IgnoredMulti MemErrors
Udp: 161 0 4 169 5 6 0 0 0
UdpLite: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors SndbufErrors InCsumErrors IgnoredMulti MemErrors
UdpLite: 0 0 0 0 0 0 0 0 0
"""

NETSTAT = b"""TcpExt: SyncookiesSent TCPLostRetransmit TCPTimeouts TCPLossProbes TCPSynRetrans TCPOrigDataSent
TcpExt: 0 11 231 4 2 1029
IpExt: InNoRoutes InTruncatedPkts
IpExt: 0 0
"""

# Linux 6.1 with mac80211_hwsim, a station that is associated
WIRELESS = b"""Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE
 face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22
 wlan1: 0000   38.  -72.  -256        0      0      0      0      8        0
"""
WIRELESS_HEAD = WIRELESS[: WIRELESS.index(b" wlan1")]
