import json,glob,sys
from bristle.plant.effects import effects
grp={n:e.group for n,e in effects().items()}
T=float(sys.argv[1]) if len(sys.argv)>1 else 6
import collections
tot=collections.Counter()
for f in sorted(glob.glob('/tmp/lead/frozen-out/results/*.json')):
    r=json.load(open(f)); a=json.load(open(f.replace('/results/','/answers/')))
    if a['style']!='rich': continue
    truth={e['class'] for e in a['effects']}
    done=set()
    for k,rd in enumerate(r['rounds']):
        if not rd['added']: continue
        ah=[c for c in rd['candidates'] if c.get('behind') is not None and c['behind']<-T and grp[c['name']]!=grp[rd['added']]]
        if ah:
            b=min(ah,key=lambda c:c['behind']); ad=next(c for c in rd['candidates'] if c['name']==rd['added'])
            right=grp[rd['added']] in truth; bright=grp[b['name']] in truth
            tot[right,bright,a['kind']]+=1
            print(f[-10:-5],a['group'],k,sorted(truth) or a['variant'],'added',rd['added'],right,'ahead',b['name'],bright,round(b['behind'],1),'doubt',round(b['doubt'],1),'falls',round(ad['size'],2),round(b['size'],2),'kept',round(ad['kept']),round(b['kept']),'gain/lev',round(ad['gain']/ad['level'],1),round(b['gain']/b['level'],1),round(a['gap']['ratio'],1))
print(tot)
