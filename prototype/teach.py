"""States labelled by the optimal plan. python teach.py SEED COUNT OUT"""
import sys,time; sys.path.insert(0,'prototype')
import numpy as np
from gen import section, trainset
from dataclasses import replace
from metropilot.railway.trainset import Actuation
from metropilot.task import Run, Scenario, declared_bounds
from metropilot.task.tables import build_tables, Rows, PERMITTED
from metropilot.task.observers import Sight, observe, OBSERVERS
from metropilot.planning import PlanOptions, plan_arrays
FEAT=OBSERVERS["line"]
WINDOW=30.0; LATE=500.0
def prepared(s,t):
    run=Run(s,t,100.0,Scenario(),0.2)
    tb=build_tables([(s,t,declared_bounds(run))],4.0,np.float64)
    return Rows(tb,jax=False)
def sights(rows,t_s,x,v,sched,spread=1.0):
    c=rows.case(0); z=np.zeros_like(x)
    return Sight(rows,0,c.vehicle,c.track,c.length_m,c.load,c.stop_mps2,c.protection.rates,t_s,x,v,z,sched,z)
def features(sight):
    return observe(FEAT, sight).T if False else obs(sight)
def obs(sight):
    from metropilot.task.observers import FEATURES
    n=np.shape(sight.speed_mps)
    vals=[np.broadcast_to(np.asarray(a,np.float64),n) for name in FEAT for a in FEATURES[name](sight)]
    return np.stack(vals,1).astype(np.float32)
def options(rows,**k):
    c=rows.case(0); L=float(c.length_m)
    at=np.arange(0,L+4,4.0); cap=rows.ground_at(PERMITTED,0,at)-.2
    j=float(c.vehicle.jerk_mps3); j=j if np.isfinite(j) else None
    return PlanOptions(cap_m=at,cap_mps=np.maximum(cap,.5),late_w=LATE,deceleration_mps2=float(c.stop_mps2),jerk_mps3=j,spacing_m=12.5,**k)
def label(plan,m_eff,x,L):
    f=(plan.traction_n-plan.brake_n)*np.diff(plan.position_m)
    W=np.concatenate([[0],np.cumsum(f)]); h=np.minimum(WINDOW,np.maximum(L-x,1.0))
    return (np.interp(x+h,plan.position_m,W)-np.interp(x,plan.position_m,W))/h/m_eff
def along(plan,rows,sched,t0,r,n):
    """n states along a plan, even in time."""
    c=rows.case(0); L=float(c.length_m)
    tt=np.sort(r.uniform(0,plan.running_time_s*.995,n)); x=np.interp(tt,plan.time_s,plan.position_m)
    e=np.interp(x,plan.position_m,plan.speed_mps**2); v=np.sqrt(np.maximum(e,0))
    y=label(plan,float(c.vehicle.effective_mass_kg),x,L)
    return x,v,t0+tt,y
def one(r,perturb=5,n=60):
    s=section(r); top=max(s.limit_mps.value.max(),60/3.6)
    t=trainset(r,top)
    if r.random()<.5: t=replace(t,actuation=Actuation(0.0,0.0,float(r.uniform(.5,1.5))))
    rows=prepared(s,t); c=rows.case(0); L=float(c.length_m); T=float(c.minimum_s)*float(1.02+.6*r.beta(1.2,2.2))
    X,Y=[],[]
    def take(plan,t0,n):
        x,v,ts,y=along(plan,rows,T,t0,r,n)
        X.append(obs(sights(rows,ts,x,v,np.full_like(x,T)))); Y.append(y)
        return x,v,ts
    plan=plan_arrays(c.vehicle,c.track,T,options(rows)); x,v,ts=take(plan,0.0,n)
    for k in range(perturb):
        i=r.integers(0,int(n*.92)); x0=float(x[i])
        cap=float(rows.ground_at(PERMITTED,0,np.array(x0)))-.25
        v0=float(np.clip(v[i]+r.normal(0,1.5),.3,max(cap,.3)))
        v0=min(v0,np.sqrt(2*.97*float(c.stop_mps2)*max(L-x0,.1)))
        left=(T-ts[i])*float(1+r.normal(0,.04))+float(r.normal(0,1.0))
        try: p=plan_arrays(c.vehicle,c.track,left,options(rows,start_m=x0,start_mps=v0))
        except Exception as e: fails.append(type(e).__name__); continue
        take(p,T-left,n)
    return np.concatenate(X),np.concatenate(Y)
fails=[]
if __name__=="__main__":
    seed,count,out=int(sys.argv[1]),int(sys.argv[2]),sys.argv[3]
    Xs,Ys=[],[]; a=time.time()
    for k in range(count):
        r=np.random.default_rng([seed,k])
        try: X,Y=one(r)
        except Exception as e: fails.append(repr(e)[:200]); continue
        ok=np.isfinite(X).all(1)&np.isfinite(Y); Xs.append(X[ok]); Ys.append(Y[ok])
        if k%200==199: print(k+1,round(time.time()-a),sum(map(len,Ys)),len(fails),fails[-2:],flush=True)
    np.savez(out,X=np.concatenate(Xs),Y=np.concatenate(Ys).astype(np.float32))
    print("done",round(time.time()-a),sum(map(len,Ys)),len(fails),fails[:5])
