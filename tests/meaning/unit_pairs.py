"""Pairs of units with published factors: NIST SP 811 (appendix B.8), the SI brochure, UCUM.

Each line: one unit, another, the factor from the one to the other, and an offset where there is
one. Factors with a slash are exact by definition; decimals stand as published.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

# What a definition makes exact.
EXACT = """
[in_i] m 0.0254
[in_i] cm 2.54
[in_i] mm 25.4
[ft_i] m 0.3048
[ft_i] [in_i] 12
[yd_i] m 0.9144
[yd_i] [ft_i] 3
[mi_i] m 1609.344
[mi_i] km 1.609344
[mi_i] [ft_i] 5280
[nmi_i] m 1852
km m 1000
m mm 1000
m cm 100
cm mm 10
um m 1/1000000
um mm 1/1000
nm um 1/1000
mm m 1/1000
dm m 0.1
metres mm 1000
feet m 0.3048
inches cm 2.54
m2 cm2 10000
[ft_i]2 m2 0.09290304
[in_i]2 cm2 6.4516
[in_i]3 cm3 16.387064
m3 L 1000
L mL 1000
L m3 1/1000
mL cm3 1
dm3 L 1
[gal_us] L 3.785411784
min s 60
h s 3600
h min 60
d h 24
d s 86400
wk d 7
ms s 1/1000
us s 1/1000000
ns s 1/1000000000
ns ms 1/1000000
us ms 1/1000
s ns 1000000000
seconds ms 1000
nanosec s 1/1000000000
km/h m/s 5/18
m/s km/h 18/5
[mi_i]/h m/s 0.44704
[mi_i]/h km/h 1.609344
[kn_i] m/s 463/900
[kn_i] km/h 1.852
mph m/s 0.44704
kmh m/s 5/18
m/min m/s 1/60
mm/s m/s 1/1000
cm/s m/s 1/100
m/s m/min 60
mm/min m/s 1/60000
[ft_i]/s m/s 0.3048
[ft_i]/min m/s 0.00508
m/s^2 cm/s**2 100
[g] m/s2 9.80665
m/s2 km/h/s 18/5
kg g 1000
g kg 1/1000
mg g 1/1000
t kg 1000
ug mg 1/1000
[lb_av] kg 0.45359237
[oz_av] g 28.349523125
[lb_av] [oz_av] 16
kN N 1000
mN N 1/1000
[lbf_av] N 4.4482216152605
N kg.m/s2 1
N.m N.cm 100
N.m mN.m 1000
Nm mNm 1000
kNm N.m 1000
Nm.s/rad mN.m.s/rad 1000
Nm/A kg.m2/(s2.A) 1
rads/s mrad/s 1000
fps Hz 1
kG T 0.1
uG nT 0.1
Ohm uOhm 1000000
TBy GBy 1000
m[H2O] kPa 9.80665
kN.m N.m 1000
kPa Pa 1000
hPa Pa 100
mbar Pa 100
mbar hPa 1
bar Pa 100000
bar kPa 100
MPa bar 10
atm Pa 101325
Torr Pa 20265/152
Pa N/m2 1
J N.m 1
kJ J 1000
W.h J 3600
kW.h J 3600000
kW.h MJ 3.6
cal J 4.184
kcal kJ 4.184
[Btu_IT] J 1055.05585262
eV J 1.602176634e-19
W J/s 1
kW W 1000
mW W 1/1000
W mW 1000
J/min W 1/60
[HP] W 745.69987158227022
V mV 1000
mV V 1/1000
kV V 1000
uV mV 1/1000
A mA 1000
mA A 1/1000
uA mA 1/1000
A.h C 3600
A.h mA.h 1000
mA.h C 3.6
mAh Ah 1/1000
V.A W 1
Ohm kOhm 1/1000
kOhm Ohm 1000
MOhm kOhm 1000
uF F 1/1000000
nF uF 1/1000
mH H 1/1000
T mT 1000
uT T 1/1000000
G T 1/10000
mG uT 0.1
gauss uT 100
Hz kHz 1/1000
kHz Hz 1000
MHz kHz 1000
GHz MHz 1000
/s Hz 1
/min Hz 1/60
1/min /s 1/60
/min /h 60
bpm Hz 1/60
{beats}/min /s 1/60
L/min mL/s 50/3
L/min L/s 1/60
L/min L/h 60
L/h L/min 1/60
m3/h L/min 50/3
mL/h mL/min 1/60
Cel/min Cel/s 1/60
K/min K/s 1/60
K/h K/min 1/60
[degF]/min K/min 5/9
rpm {rev}/s 1/60
{rev}/min {rev}/s 1/60
circ deg 360
deg ' 60
deg '' 3600
' '' 60
gon deg 0.9
deg/s {rev}/min 1/6
rpm deg/s 6
deg/s deg/min 60
deg/s2 deg/min2 3600
% 1 1/100
1 % 100
[ppm] 1 1/1000000
[ppth] % 1/10
[ppm] % 1/10000
mm/m % 1/10
kg/m3 g/L 1
g/cm3 kg/m3 1000
mg/m3 ug/m3 1000
ug/m3 kg/m3 1e-9
kg.m2 g.cm2 10000000
N/mm N/m 1000
J/(kg.K) J/(g.K) 1/1000
W/(m2.K) mW/(cm2.K) 1/10
m2/s mm2/s 1000000
Pa.s mPa.s 1000
P Pa.s 1/10
By bit 8
kBy By 1000
MBy kBy 1000
MBy/s By/s 1000000
lx lm/m2 1
mcd cd 1/1000
2.10*3.m km 2
60.s min 1
mol mmol 1000
mmol/L mol/m3 1
K mK 1000
K [degF]/1 9/5
"""
# With an offset: `factor * number + offset`.
OFFSETS = """
Cel K 1 273.15
K Cel 1 -273.15
Cel [degF] 9/5 32
[degF] Cel 5/9 -160/9
[degF] K 5/9 45967/180
K [degF] 9/5 -459.67
celsius fahrenheit 9/5 32
degC degF 9/5 32
°C °F 9/5 32
Cel mK 1000 273150
[degR] K 5/9 0
Cel [degR] 9/5 491.67
"""
# Rounded where they were published, or with pi.
ROUNDED = """
deg rad 0.017453292519943295
rad deg 57.29577951308232
degrees radians 0.017453292519943295
rpm rad/s 0.10471975511965978
rad/s rpm 9.549296585513721
deg/s rad/s 0.017453292519943295
rad/s deg/s 57.29577951308232
' rad 2.908882e-4
'' rad 4.848137e-6
gon rad 1.570796e-2
circ rad 6.283185307179586
{rev}/s rad/s 6.283185307179586
deg/s2 rad/s2 0.017453292519943295
mrad rad 0.001
mrad deg 0.05729577951308232
sr deg2 3282.806350011744
[psi] Pa 6894.757
[psi] kPa 6.894757
[psi] bar 0.06894757
mm[Hg] Pa 133.3224
mm[Hg] kPa 0.1333224
cm[H2O] Pa 98.0665
[in_i'Hg] Pa 3386.389
[HP] kW 0.7456999
[lbf_av].[ft_i] N.m 1.355818
N.m [lbf_av].[in_i] 8.850746
kW [HP] 1.341022
[oz_av].[in_i]2 kg.m2 1.829e-5
a d 365.25
u kg 1.660539e-27
"""


def pairs() -> Iterator[tuple[str, str, Fraction, Fraction, bool]]:
    """Yield the two units, factor, offset, and whether they are exact."""
    for text, exact in ((EXACT, True), (OFFSETS, True), (ROUNDED, False)):
        for line in text.strip().splitlines():
            one, other, factor, *offset = line.split()
            yield one, other, Fraction(factor), Fraction(offset[0] if offset else 0), exact
