"""python evalg.py NET [ideal|jerk]"""
import sys,pickle,time,os
import numpy as np, jax, jax.numpy as jnp
jax.config.update("jax_compilation_cache_dir","cache")
from metropilot.task import *
from metropilot.task.registry import _all,_loads
from metropilot.task.config import DrivingConfig
from metropilot.task.actions import EffortAction
from metropilot.task.optima import optima_of
from metropilot.task.assist import Assists
from metropilot.task.scenarios import Scenarios
net=sys.argv[1]; ideal=sys.argv[2]=="ideal"
P,mu,sd=pickle.load(open(net,"rb"))
cfg=DrivingConfig(_all(),_loads(),Scenarios(time_ratio=(1.05,1.4)),ideal=ideal,observer="line",action=EffortAction(),dt=0.2,periods=2,most_decisions=3000)
task=DrivingTask(cfg)
f="opt.pkl"
if os.path.exists(f): opt=pickle.load(open(f,"rb"))
else:
    opt=optima_of([(s,t.ideal()) for s,t in cfg.cases],ratios=(1.01,1.03,1.05,1.08,1.1,1.15,1.2,1.3,1.4,1.6)); pickle.dump(opt,open(f,"wb"))
C=task.rows.count; mins=np.asarray(task.minimum_s)
cases,times,kind=[],[],[]
for c,(s,t) in enumerate(cfg.cases):
    pl=s.planned_time_s
    for k,T in (("plan",pl),("1.05",1.05*mins[c]),("1.1",1.1*mins[c]),("1.2",1.2*mins[c]),("1.4",1.4*mins[c])):
        if T is None or T<1.05*mins[c]-1e-3: continue
        cases.append(c); times.append(float(T)); kind.append(k)
cases=np.array(cases); times=np.array(times); kind=np.array(kind)
def policy(x):
    h=(x-mu)/sd
    for W,b in P[:-1]: h=jax.nn.silu(h@W+b)
    return jnp.clip((h@P[-1][0]+P[-1][1]),-1,1)
st=starts(cases.tolist(),times.tolist())
@jax.jit
def roll():
    s,o=jax.vmap(task.begin)(st)
    def one(c,_):
        s,o,d=c; a=policy(o)
        s2,t=jax.vmap(task.step)(jax.random.split(jax.random.key(0),len(cases)),s,a)
        s=jax.tree.map(lambda x,y: jnp.where(d.reshape(d.shape+(1,)*(x.ndim-1)),y,x),s2,s)
        return (s,jnp.where(d[:,None],o,t.observation),d|t.terminated),None
    (s,o,d),_=jax.lax.scan(one,(s,o,jnp.zeros(len(cases),bool)),None,length=800)
    return jax.vmap(lambda x: episode_of(task,x))(s)
a=time.time(); e=jax.tree.map(np.asarray,roll())
gap=100*opt.gap(cases,np.clip(e.running_time_s,opt.time_s[cases,0],opt.time_s[cases,-1]),e.wheel_j)
late=e.running_time_s-e.scheduled_s; ok=e.outcome==0
print(net,sys.argv[2],"arrived",ok.mean(),"gap med %.2f p90 %.2f p95 %.2f max %.2f"%(np.nanmedian(gap),*np.nanpercentile(gap,[90,95]),np.nanmax(gap)),"late abs med %.2f p95 %.2f max %.2f"%(np.median(abs(late)),np.percentile(abs(late),95),abs(late).max()),"stop %.3f"%abs(e.stop_error_m[ok]).max(),"int",(e.interventions>0).sum(),round(time.time()-a))
for k in ("plan","1.05","1.1","1.2","1.4"):
    m=kind==k; print(k,m.sum(),"gap med %.2f p95 %.2f max %.2f"%(np.nanmedian(gap[m]),np.nanpercentile(gap[m],95),np.nanmax(gap[m])),"late %.2f..%.2f"%(late[m].min(),late[m].max()))
w=np.argsort(-np.nan_to_num(gap,nan=99))[:8]
for i in w: s,t=cfg.cases[cases[i]]; print(s.name,t.load,kind[i],round(times[i],1),"gap %.1f late %.2f"%(gap[i],late[i]),e.outcome[i])
w=np.argsort(-abs(late))[:6]
for i in w: s,t=cfg.cases[cases[i]]; print("late",s.name,t.load,kind[i],round(times[i],1),"gap %.1f late %.2f"%(gap[i],late[i]),e.outcome[i],"int",e.interventions[i])
