"""python imit.py OUT STEPS DATA... [--init FILE]"""
import sys,time,pickle
import numpy as np, jax, jax.numpy as jnp
jax.config.update("jax_compilation_cache_dir","cache")
out,steps=sys.argv[1],int(sys.argv[2]); data=sys.argv[3:]
X=np.concatenate([np.load(f)["X"] for f in data]); Y=np.concatenate([np.load(f)["Y"] for f in data])
Y=np.clip(Y/1.5,-1,1)
print(X.shape)
mu,sd=X.mean(0),X.std(0)+1e-3
H=(128,128,128); rng=np.random.default_rng(0)
sizes=[X.shape[1],*H,1]
P=[(rng.normal(0,1/np.sqrt(a),(a,b)).astype(np.float32),np.zeros(b,np.float32)) for a,b in zip(sizes,sizes[1:])]
n=len(X)//20; val=slice(0,n)  # first cases: unseen sections
Xv,Yv=jnp.asarray((X[:n]-mu)/sd),jnp.asarray(Y[:n]); Xt,Yt=(X[n:]-mu)/sd,Y[n:]
def f(P,x):
    for W,b in P[:-1]: x=jax.nn.silu(x@W+b)
    return (x@P[-1][0]+P[-1][1])[:,0]
D=.03
def loss(P,x,y):
    e=jnp.abs(f(P,x)-y); return jnp.mean(jnp.where(e<D,e*e/(2*D),e-D/2))
B=1024; K=100
@jax.jit
def many(P,M,V,k,xs,ys):
    def one(c,b):
        P,M,V,k=c; x,y=b; k=k+1
        g=jax.grad(loss)(P,x,y); lr=1e-3*jnp.minimum(1,k/500)*(0.5*(1+jnp.cos(jnp.pi*jnp.minimum(k/steps,1.)))+.003)
        M=jax.tree.map(lambda m,g:.9*m+.1*g,M,g); V=jax.tree.map(lambda v,g:.999*v+.001*g*g,V,g)
        P=jax.tree.map(lambda p,m,v:p-lr*(m/(1-.9**k))/(jnp.sqrt(v/(1-.999**k))+1e-8),P,M,V)
        return (P,M,V,k),None
    c,_=jax.lax.scan(one,(P,M,V,k),(xs,ys)); return c
Z=jax.tree.map(np.zeros_like,P); c=(P,Z,Z,jnp.float32(0)); a=time.time()
for i in range(steps//K):
    idx=rng.integers(0,len(Xt),(K,B)); c=many(*c,Xt[idx],Yt[idx])
    if i%40==39: print((i+1)*K,round(time.time()-a),"val",float(loss(c[0],Xv,Yv)),"mae",float(jnp.abs(f(c[0],Xv)-Yv).mean()*1.5),flush=True)
pickle.dump((jax.tree.map(np.asarray,c[0]),mu,sd),open(out,"wb"))
