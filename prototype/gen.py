"""Random sections and trainsets."""
import numpy as np
from metropilot.railway.profile import Steps
from metropilot.railway.line import Section, Station
from metropilot.railway import EffortCurve, Trainset
from metropilot.railway.trainset import Davis, Actuation, SafeBraking
import inspect
def pieces(r, length, low, high):
    at=[0.0]
    while at[-1]<length: at.append(at[-1]+r.uniform(low,high))
    return np.array(at[:-1])
def section(r):
    L=float(np.exp(r.uniform(np.log(500),np.log(8000)))) if r.random()<.5 else float(r.uniform(700,3200))
    # gradients
    steep=r.choice([6.,14.,28.,40.],p=[.3,.3,.3,.1])
    g_at=pieces(r,L+800,100,800)-400
    g=np.clip(r.normal(0,steep/1.6,g_at.size),-steep,steep)
    if r.random()<.3: g[r.random(g.size)<.4]=0
    g[np.abs(g)<.1]=0
    # a station is near flat
    top=r.uniform(45,120) if L>2500 else r.uniform(40,95)
    l_at=pieces(r,L+400,150,1500)-200
    v=np.minimum(top*r.choice([1,1,1,.85,.7,.55],size=l_at.size),120)
    v=np.maximum(np.round(v),30)
    pos=[*l_at]; val=[*v]
    if r.random()<.5:  # platform zone at the end
        z=r.uniform(60,180); pos=[p for p in pos if p<L-z-30]+[L-z]; val=val[:len(pos)-1]+[r.choice([50.,55.,60.])]
    if r.random()<.4: # and at the start
        z=r.uniform(5,150); keep=[(p,x) for p,x in zip(pos,val) if p>z+30]; 
        pos=[-500.,z]+[p for p,_ in keep]; val=[r.choice([50.,55.,60.]),max(val[0],60)]+[x for _,x in keep]
    pos=np.array(pos); val=np.array(val)/3.6
    a,b=Station("A","A",0.0),Station("B","B",L)
    return Section("random",a,b,L,Steps(pos,val),Steps(g_at,g))
def trainset(r, top=120/3.6):
    m=float(np.exp(r.uniform(np.log(80e3),np.log(500e3))))
    acc=r.uniform(.6,1.3); knee=r.uniform(8,17); power=r.uniform(.9,1.9)
    v=np.linspace(0,36,37); f=m*acc*np.where(v<=knee,1,(np.maximum(v,knee)/knee)**-power)
    dec=r.uniform(.75,1.2)
    d=Davis(m*9.81e-3*r.uniform(1.0,3.0),m*9.81e-3*.0622*3.6*r.uniform(.0,1.4),m*9.81e-3*.0018*12.96*r.uniform(.4,1.6))
    return Trainset("random","random",{"A":m},"A",davis=d,traction=EffortCurve.table(v,f),electric_brake=EffortCurve.constant(m*dec*r.uniform(.7,1)),
      length_m=float(r.choice([0,r.uniform(40,190)])),rotating_fraction=float(r.choice([0,.06,.1])),friction_brake_n=m*dec*.6,service_deceleration_mps2=dec,
      max_acceleration_mps2=1.3 if r.random()<.5 else 1.0,max_deceleration_mps2=max(dec,1.0),max_speed_mps=top,
      actuation=Actuation(), safe_braking=SafeBraking(emergency_deceleration_mps2=1.25,service_deceleration_mps2=dec,reaction_s=.3,buildup_s=.6))
